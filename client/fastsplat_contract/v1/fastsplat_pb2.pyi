import datetime

from google.protobuf import empty_pb2 as _empty_pb2
from google.protobuf import struct_pb2 as _struct_pb2
from google.protobuf import timestamp_pb2 as _timestamp_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class OperationState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OPERATION_STATE_UNSPECIFIED: _ClassVar[OperationState]
    OPERATION_STATE_QUEUED: _ClassVar[OperationState]
    OPERATION_STATE_RUNNING: _ClassVar[OperationState]
    OPERATION_STATE_SUCCEEDED: _ClassVar[OperationState]
    OPERATION_STATE_FAILED: _ClassVar[OperationState]
    OPERATION_STATE_CANCELLED: _ClassVar[OperationState]

class OperationKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OPERATION_KIND_UNSPECIFIED: _ClassVar[OperationKind]
    OPERATION_KIND_CREATE_SCENE: _ClassVar[OperationKind]
    OPERATION_KIND_LOOK_AGAIN: _ClassVar[OperationKind]
    OPERATION_KIND_ASK_CAPTIONER: _ClassVar[OperationKind]

class WorkerState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    WORKER_STATE_UNSPECIFIED: _ClassVar[WorkerState]
    WORKER_STATE_NONE: _ClassVar[WorkerState]
    WORKER_STATE_WAITING: _ClassVar[WorkerState]
    WORKER_STATE_WORKING: _ClassVar[WorkerState]
    WORKER_STATE_SILENT: _ClassVar[WorkerState]

class DraftStage(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    DRAFT_STAGE_UNSPECIFIED: _ClassVar[DraftStage]
    DRAFT_STAGE_POINTS: _ClassVar[DraftStage]
    DRAFT_STAGE_TRAINING: _ClassVar[DraftStage]

class AgainAfter(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    AGAIN_AFTER_UNSPECIFIED: _ClassVar[AgainAfter]
    AGAIN_AFTER_CANCELLED: _ClassVar[AgainAfter]
    AGAIN_AFTER_FAILED: _ClassVar[AgainAfter]
    AGAIN_AFTER_WORKER_STOPPED: _ClassVar[AgainAfter]
    AGAIN_AFTER_WORKER_DIED: _ClassVar[AgainAfter]
    AGAIN_AFTER_TRAINER_DIED: _ClassVar[AgainAfter]

class SceneState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SCENE_STATE_UNSPECIFIED: _ClassVar[SceneState]
    SCENE_STATE_TRAINING: _ClassVar[SceneState]
    SCENE_STATE_READY: _ClassVar[SceneState]
    SCENE_STATE_FAILED: _ClassVar[SceneState]
    SCENE_STATE_CANCELLED: _ClassVar[SceneState]

class Scale(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SCALE_UNSPECIFIED: _ClassVar[Scale]
    SCALE_METRIC: _ClassVar[Scale]
    SCALE_ARBITRARY: _ClassVar[Scale]

class Convention(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CONVENTION_UNSPECIFIED: _ClassVar[Convention]
    CONVENTION_OPENCV: _ClassVar[Convention]
    CONVENTION_OPENGL: _ClassVar[Convention]

class Grade(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    GRADE_UNSPECIFIED: _ClassVar[Grade]
    GRADE_GOOD: _ClassVar[Grade]
    GRADE_FAIR: _ClassVar[Grade]
    GRADE_POOR: _ClassVar[Grade]

class ScaleSource(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SCALE_SOURCE_UNSPECIFIED: _ClassVar[ScaleSource]
    SCALE_SOURCE_KNOWN_LENGTH: _ClassVar[ScaleSource]
    SCALE_SOURCE_TAGS: _ClassVar[ScaleSource]
    SCALE_SOURCE_SENSOR_DEPTH: _ClassVar[ScaleSource]
    SCALE_SOURCE_ARKIT: _ClassVar[ScaleSource]
    SCALE_SOURCE_GPS: _ClassVar[ScaleSource]
    SCALE_SOURCE_POINT_PAIRS: _ClassVar[ScaleSource]

class VerticalSource(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    VERTICAL_SOURCE_UNSPECIFIED: _ClassVar[VerticalSource]
    VERTICAL_SOURCE_METADATA: _ClassVar[VerticalSource]
    VERTICAL_SOURCE_HORIZON: _ClassVar[VerticalSource]
    VERTICAL_SOURCE_PLANES: _ClassVar[VerticalSource]
    VERTICAL_SOURCE_CAMERAS: _ClassVar[VerticalSource]

class NotPlaced(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    NOT_PLACED_UNSPECIFIED: _ClassVar[NotPlaced]
    NOT_PLACED_FEW_FEATURES: _ClassVar[NotPlaced]
    NOT_PLACED_NO_OVERLAP: _ClassVar[NotPlaced]
    NOT_PLACED_FEW_MATCHES: _ClassVar[NotPlaced]
    NOT_PLACED_OTHER_MODEL: _ClassVar[NotPlaced]
    NOT_PLACED_MASKED: _ClassVar[NotPlaced]
    NOT_PLACED_UNKNOWN: _ClassVar[NotPlaced]
    NOT_PLACED_LENS: _ClassVar[NotPlaced]
    NOT_PLACED_UNREADABLE: _ClassVar[NotPlaced]

class PhotoDefect(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PHOTO_DEFECT_UNSPECIFIED: _ClassVar[PhotoDefect]
    PHOTO_DEFECT_BLURRED: _ClassVar[PhotoDefect]
    PHOTO_DEFECT_DARK: _ClassVar[PhotoDefect]
    PHOTO_DEFECT_DUPLICATE: _ClassVar[PhotoDefect]

class NameSource(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    NAME_SOURCE_UNSPECIFIED: _ClassVar[NameSource]
    NAME_SOURCE_GIVEN: _ClassVar[NameSource]
    NAME_SOURCE_DETECTED: _ClassVar[NameSource]
    NAME_SOURCE_PERSON: _ClassVar[NameSource]

class ObjectKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OBJECT_KIND_UNSPECIFIED: _ClassVar[ObjectKind]
    OBJECT_KIND_OBJECT: _ClassVar[ObjectKind]
    OBJECT_KIND_SURFACE: _ClassVar[ObjectKind]
    OBJECT_KIND_PART: _ClassVar[ObjectKind]

class ReadKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    READ_KIND_UNSPECIFIED: _ClassVar[ReadKind]
    READ_KIND_TEXT: _ClassVar[ReadKind]
    READ_KIND_QR: _ClassVar[ReadKind]
    READ_KIND_BARCODE: _ClassVar[ReadKind]
    READ_KIND_TAG: _ClassVar[ReadKind]

class MaskEncoding(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    MASK_ENCODING_UNSPECIFIED: _ClassVar[MaskEncoding]
    MASK_ENCODING_RLE: _ClassVar[MaskEncoding]
    MASK_ENCODING_PNG: _ClassVar[MaskEncoding]

class AskedLevel(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ASKED_LEVEL_UNSPECIFIED: _ClassVar[AskedLevel]
    ASKED_LEVEL_LIKELIEST: _ClassVar[AskedLevel]
    ASKED_LEVEL_PART: _ClassVar[AskedLevel]
    ASKED_LEVEL_OBJECT: _ClassVar[AskedLevel]
    ASKED_LEVEL_GROUP: _ClassVar[AskedLevel]

class PickLevel(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PICK_LEVEL_UNSPECIFIED: _ClassVar[PickLevel]
    PICK_LEVEL_PART: _ClassVar[PickLevel]
    PICK_LEVEL_OBJECT: _ClassVar[PickLevel]
    PICK_LEVEL_GROUP: _ClassVar[PickLevel]

class EditAction(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    EDIT_ACTION_UNSPECIFIED: _ClassVar[EditAction]
    EDIT_ACTION_RECOLOR: _ClassVar[EditAction]
    EDIT_ACTION_REMOVE: _ClassVar[EditAction]
    EDIT_ACTION_MOVE: _ClassVar[EditAction]
    EDIT_ACTION_DUPLICATE: _ClassVar[EditAction]
    EDIT_ACTION_NAME: _ClassVar[EditAction]
    EDIT_ACTION_UNNAME: _ClassVar[EditAction]
    EDIT_ACTION_MERGE: _ClassVar[EditAction]
    EDIT_ACTION_DISCARD: _ClassVar[EditAction]
    EDIT_ACTION_INSERT: _ClassVar[EditAction]
    EDIT_ACTION_SPLIT: _ClassVar[EditAction]
    EDIT_ACTION_ADD: _ClassVar[EditAction]
    EDIT_ACTION_LOOK_AGAIN: _ClassVar[EditAction]
    EDIT_ACTION_SCALE: _ClassVar[EditAction]
    EDIT_ACTION_ALIGN: _ClassVar[EditAction]
    EDIT_ACTION_SUGGEST: _ClassVar[EditAction]
    EDIT_ACTION_OBSERVE: _ClassVar[EditAction]

class ObjectSide(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OBJECT_SIDE_UNSPECIFIED: _ClassVar[ObjectSide]
    OBJECT_SIDE_LONGEST: _ClassVar[ObjectSide]
    OBJECT_SIDE_HEIGHT: _ClassVar[ObjectSide]

class Output(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OUTPUT_UNSPECIFIED: _ClassVar[Output]
    OUTPUT_MASK2D: _ClassVar[Output]
    OUTPUT_MASK3D: _ClassVar[Output]
    OUTPUT_OBJECTS: _ClassVar[Output]

class Mask3dEncoding(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    MASK3D_ENCODING_UNSPECIFIED: _ClassVar[Mask3dEncoding]
    MASK3D_ENCODING_BITS: _ClassVar[Mask3dEncoding]
    MASK3D_ENCODING_RUNS: _ClassVar[Mask3dEncoding]
    MASK3D_ENCODING_INDICES: _ClassVar[Mask3dEncoding]
    MASK3D_ENCODING_PLY: _ClassVar[Mask3dEncoding]

class Relation(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    RELATION_UNSPECIFIED: _ClassVar[Relation]
    RELATION_SAME: _ClassVar[Relation]
    RELATION_KIND_OF: _ClassVar[Relation]
    RELATION_PART_OF: _ClassVar[Relation]
    RELATION_RELATED: _ClassVar[Relation]
    RELATION_ABSENT: _ClassVar[Relation]
    RELATION_UNDECIDED: _ClassVar[Relation]

class RelationSubject(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    RELATION_SUBJECT_UNSPECIFIED: _ClassVar[RelationSubject]
    RELATION_SUBJECT_LABEL: _ClassVar[RelationSubject]
    RELATION_SUBJECT_QUESTION: _ClassVar[RelationSubject]

class AnswerMethod(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ANSWER_METHOD_UNSPECIFIED: _ClassVar[AnswerMethod]
    ANSWER_METHOD_LEXICON: _ClassVar[AnswerMethod]
    ANSWER_METHOD_ENCODER: _ClassVar[AnswerMethod]
    ANSWER_METHOD_NAMES: _ClassVar[AnswerMethod]

class Asks(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ASKS_UNSPECIFIED: _ClassVar[Asks]
    ASKS_OBJECTS: _ClassVar[Asks]
    ASKS_COUNT: _ClassVar[Asks]

class RefusalReason(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    REFUSAL_REASON_UNSPECIFIED: _ClassVar[RefusalReason]
    REFUSAL_REASON_NOT_UNDERSTOOD: _ClassVar[RefusalReason]
    REFUSAL_REASON_AMBIGUOUS: _ClassVar[RefusalReason]
    REFUSAL_REASON_POSE_NEEDED: _ClassVar[RefusalReason]
    REFUSAL_REASON_VERTICAL_UNKNOWN: _ClassVar[RefusalReason]
    REFUSAL_REASON_TOO_CLOSE: _ClassVar[RefusalReason]
    REFUSAL_REASON_OUT_OF_VIEW: _ClassVar[RefusalReason]
    REFUSAL_REASON_INDIRECT: _ClassVar[RefusalReason]
    REFUSAL_REASON_AMBIGUOUS_REFERENT: _ClassVar[RefusalReason]
    REFUSAL_REASON_REFERENT_ABSENT: _ClassVar[RefusalReason]
    REFUSAL_REASON_NOTHING_TO_COMPARE: _ClassVar[RefusalReason]
    REFUSAL_REASON_NOT_MEASURED: _ClassVar[RefusalReason]
    REFUSAL_REASON_NOT_NAMED: _ClassVar[RefusalReason]
    REFUSAL_REASON_NOT_READ: _ClassVar[RefusalReason]

class Outcome(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OUTCOME_UNSPECIFIED: _ClassVar[Outcome]
    OUTCOME_HERE: _ClassVar[Outcome]
    OUTCOME_PROBABLY_HERE: _ClassVar[Outcome]
    OUTCOME_NOT_HERE: _ClassVar[Outcome]
    OUTCOME_NOT_SEEN: _ClassVar[Outcome]
    OUTCOME_CANNOT_SAY: _ClassVar[Outcome]

class PictureKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PICTURE_KIND_UNSPECIFIED: _ClassVar[PictureKind]
    PICTURE_KIND_RGB: _ClassVar[PictureKind]
    PICTURE_KIND_OVERLAY: _ClassVar[PictureKind]
    PICTURE_KIND_RELEVANCY: _ClassVar[PictureKind]
    PICTURE_KIND_MASK: _ClassVar[PictureKind]
    PICTURE_KIND_LABEL_MAP: _ClassVar[PictureKind]
    PICTURE_KIND_DEPTH: _ClassVar[PictureKind]
    PICTURE_KIND_DEPTH_PICTURE: _ClassVar[PictureKind]
    PICTURE_KIND_OBJECT_MAP: _ClassVar[PictureKind]
    PICTURE_KIND_OBJECTS: _ClassVar[PictureKind]
    PICTURE_KIND_NORMALS: _ClassVar[PictureKind]
    PICTURE_KIND_CONFIDENCE: _ClassVar[PictureKind]

class PictureFormat(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PICTURE_FORMAT_UNSPECIFIED: _ClassVar[PictureFormat]
    PICTURE_FORMAT_PNG: _ClassVar[PictureFormat]
    PICTURE_FORMAT_NPY: _ClassVar[PictureFormat]
    PICTURE_FORMAT_JPEG: _ClassVar[PictureFormat]

class ExportFormat(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    EXPORT_FORMAT_UNSPECIFIED: _ClassVar[ExportFormat]
    EXPORT_FORMAT_PLY: _ClassVar[ExportFormat]
    EXPORT_FORMAT_SPZ: _ClassVar[ExportFormat]
    EXPORT_FORMAT_HTML: _ClassVar[ExportFormat]
    EXPORT_FORMAT_POINTS: _ClassVar[ExportFormat]
    EXPORT_FORMAT_MESH: _ClassVar[ExportFormat]
    EXPORT_FORMAT_CAMERAS: _ClassVar[ExportFormat]
    EXPORT_FORMAT_SOG: _ClassVar[ExportFormat]
    EXPORT_FORMAT_MCAP: _ClassVar[ExportFormat]
    EXPORT_FORMAT_MAP: _ClassVar[ExportFormat]
    EXPORT_FORMAT_CAMERA_LIST: _ClassVar[ExportFormat]
    EXPORT_FORMAT_TRANSFORMS: _ClassVar[ExportFormat]
    EXPORT_FORMAT_COLMAP: _ClassVar[ExportFormat]
    EXPORT_FORMAT_OBJECTS: _ClassVar[ExportFormat]
    EXPORT_FORMAT_SPZ4: _ClassVar[ExportFormat]

class NextPhotoReason(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    NEXT_PHOTO_REASON_UNSPECIFIED: _ClassVar[NextPhotoReason]
    NEXT_PHOTO_REASON_GAP: _ClassVar[NextPhotoReason]
    NEXT_PHOTO_REASON_FEW_DIRECTIONS: _ClassVar[NextPhotoReason]
    NEXT_PHOTO_REASON_HIDDEN: _ClassVar[NextPhotoReason]

class FloorSource(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    FLOOR_SOURCE_UNSPECIFIED: _ClassVar[FloorSource]
    FLOOR_SOURCE_SURFACE: _ClassVar[FloorSource]
    FLOOR_SOURCE_LOWEST_LEVEL: _ClassVar[FloorSource]

class CovarianceTerm(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    COVARIANCE_TERM_UNSPECIFIED: _ClassVar[CovarianceTerm]
    COVARIANCE_TERM_EDGES: _ClassVar[CovarianceTerm]
    COVARIANCE_TERM_MEMBERSHIP: _ClassVar[CovarianceTerm]
    COVARIANCE_TERM_SCALE: _ClassVar[CovarianceTerm]
    COVARIANCE_TERM_ALIGNMENT: _ClassVar[CovarianceTerm]

class SupportRelation(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SUPPORT_RELATION_UNSPECIFIED: _ClassVar[SupportRelation]
    SUPPORT_RELATION_ON: _ClassVar[SupportRelation]
    SUPPORT_RELATION_IN: _ClassVar[SupportRelation]

class LocalizeRefusal(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    LOCALIZE_REFUSAL_UNSPECIFIED: _ClassVar[LocalizeRefusal]
    LOCALIZE_REFUSAL_NO_KEYPOINTS: _ClassVar[LocalizeRefusal]
    LOCALIZE_REFUSAL_FEW_MATCHES: _ClassVar[LocalizeRefusal]
    LOCALIZE_REFUSAL_NARROW: _ClassVar[LocalizeRefusal]
    LOCALIZE_REFUSAL_LOOKS_DIFFERENT: _ClassVar[LocalizeRefusal]

class FocalSource(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    FOCAL_SOURCE_UNSPECIFIED: _ClassVar[FocalSource]
    FOCAL_SOURCE_GIVEN: _ClassVar[FocalSource]
    FOCAL_SOURCE_METADATA: _ClassVar[FocalSource]
    FOCAL_SOURCE_SCENE: _ClassVar[FocalSource]
    FOCAL_SOURCE_ESTIMATED: _ClassVar[FocalSource]

class DifferenceKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    DIFFERENCE_KIND_UNSPECIFIED: _ClassVar[DifferenceKind]
    DIFFERENCE_KIND_NEW: _ClassVar[DifferenceKind]
    DIFFERENCE_KIND_MISSING: _ClassVar[DifferenceKind]
    DIFFERENCE_KIND_CHANGED: _ClassVar[DifferenceKind]

class ChangeKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CHANGE_KIND_UNSPECIFIED: _ClassVar[ChangeKind]
    CHANGE_KIND_GONE: _ClassVar[ChangeKind]
    CHANGE_KIND_MOVED: _ClassVar[ChangeKind]
    CHANGE_KIND_NEW: _ClassVar[ChangeKind]
    CHANGE_KIND_CHANGED: _ClassVar[ChangeKind]

class SeenAtSource(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SEEN_AT_SOURCE_UNSPECIFIED: _ClassVar[SeenAtSource]
    SEEN_AT_SOURCE_GIVEN: _ClassVar[SeenAtSource]
    SEEN_AT_SOURCE_METADATA: _ClassVar[SeenAtSource]
    SEEN_AT_SOURCE_RECEIVED: _ClassVar[SeenAtSource]

class Role(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ROLE_UNSPECIFIED: _ClassVar[Role]
    ROLE_READER: _ClassVar[Role]
    ROLE_EDITOR: _ClassVar[Role]
    ROLE_ADMIN: _ClassVar[Role]
    ROLE_OPERATOR: _ClassVar[Role]
    ROLE_UPLOADER: _ClassVar[Role]
    ROLE_SUGGESTER: _ClassVar[Role]

class KeyState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    KEY_STATE_UNSPECIFIED: _ClassVar[KeyState]
    KEY_STATE_VALID: _ClassVar[KeyState]
    KEY_STATE_EXPIRED: _ClassVar[KeyState]
    KEY_STATE_REVOKED: _ClassVar[KeyState]
OPERATION_STATE_UNSPECIFIED: OperationState
OPERATION_STATE_QUEUED: OperationState
OPERATION_STATE_RUNNING: OperationState
OPERATION_STATE_SUCCEEDED: OperationState
OPERATION_STATE_FAILED: OperationState
OPERATION_STATE_CANCELLED: OperationState
OPERATION_KIND_UNSPECIFIED: OperationKind
OPERATION_KIND_CREATE_SCENE: OperationKind
OPERATION_KIND_LOOK_AGAIN: OperationKind
OPERATION_KIND_ASK_CAPTIONER: OperationKind
WORKER_STATE_UNSPECIFIED: WorkerState
WORKER_STATE_NONE: WorkerState
WORKER_STATE_WAITING: WorkerState
WORKER_STATE_WORKING: WorkerState
WORKER_STATE_SILENT: WorkerState
DRAFT_STAGE_UNSPECIFIED: DraftStage
DRAFT_STAGE_POINTS: DraftStage
DRAFT_STAGE_TRAINING: DraftStage
AGAIN_AFTER_UNSPECIFIED: AgainAfter
AGAIN_AFTER_CANCELLED: AgainAfter
AGAIN_AFTER_FAILED: AgainAfter
AGAIN_AFTER_WORKER_STOPPED: AgainAfter
AGAIN_AFTER_WORKER_DIED: AgainAfter
AGAIN_AFTER_TRAINER_DIED: AgainAfter
SCENE_STATE_UNSPECIFIED: SceneState
SCENE_STATE_TRAINING: SceneState
SCENE_STATE_READY: SceneState
SCENE_STATE_FAILED: SceneState
SCENE_STATE_CANCELLED: SceneState
SCALE_UNSPECIFIED: Scale
SCALE_METRIC: Scale
SCALE_ARBITRARY: Scale
CONVENTION_UNSPECIFIED: Convention
CONVENTION_OPENCV: Convention
CONVENTION_OPENGL: Convention
GRADE_UNSPECIFIED: Grade
GRADE_GOOD: Grade
GRADE_FAIR: Grade
GRADE_POOR: Grade
SCALE_SOURCE_UNSPECIFIED: ScaleSource
SCALE_SOURCE_KNOWN_LENGTH: ScaleSource
SCALE_SOURCE_TAGS: ScaleSource
SCALE_SOURCE_SENSOR_DEPTH: ScaleSource
SCALE_SOURCE_ARKIT: ScaleSource
SCALE_SOURCE_GPS: ScaleSource
SCALE_SOURCE_POINT_PAIRS: ScaleSource
VERTICAL_SOURCE_UNSPECIFIED: VerticalSource
VERTICAL_SOURCE_METADATA: VerticalSource
VERTICAL_SOURCE_HORIZON: VerticalSource
VERTICAL_SOURCE_PLANES: VerticalSource
VERTICAL_SOURCE_CAMERAS: VerticalSource
NOT_PLACED_UNSPECIFIED: NotPlaced
NOT_PLACED_FEW_FEATURES: NotPlaced
NOT_PLACED_NO_OVERLAP: NotPlaced
NOT_PLACED_FEW_MATCHES: NotPlaced
NOT_PLACED_OTHER_MODEL: NotPlaced
NOT_PLACED_MASKED: NotPlaced
NOT_PLACED_UNKNOWN: NotPlaced
NOT_PLACED_LENS: NotPlaced
NOT_PLACED_UNREADABLE: NotPlaced
PHOTO_DEFECT_UNSPECIFIED: PhotoDefect
PHOTO_DEFECT_BLURRED: PhotoDefect
PHOTO_DEFECT_DARK: PhotoDefect
PHOTO_DEFECT_DUPLICATE: PhotoDefect
NAME_SOURCE_UNSPECIFIED: NameSource
NAME_SOURCE_GIVEN: NameSource
NAME_SOURCE_DETECTED: NameSource
NAME_SOURCE_PERSON: NameSource
OBJECT_KIND_UNSPECIFIED: ObjectKind
OBJECT_KIND_OBJECT: ObjectKind
OBJECT_KIND_SURFACE: ObjectKind
OBJECT_KIND_PART: ObjectKind
READ_KIND_UNSPECIFIED: ReadKind
READ_KIND_TEXT: ReadKind
READ_KIND_QR: ReadKind
READ_KIND_BARCODE: ReadKind
READ_KIND_TAG: ReadKind
MASK_ENCODING_UNSPECIFIED: MaskEncoding
MASK_ENCODING_RLE: MaskEncoding
MASK_ENCODING_PNG: MaskEncoding
ASKED_LEVEL_UNSPECIFIED: AskedLevel
ASKED_LEVEL_LIKELIEST: AskedLevel
ASKED_LEVEL_PART: AskedLevel
ASKED_LEVEL_OBJECT: AskedLevel
ASKED_LEVEL_GROUP: AskedLevel
PICK_LEVEL_UNSPECIFIED: PickLevel
PICK_LEVEL_PART: PickLevel
PICK_LEVEL_OBJECT: PickLevel
PICK_LEVEL_GROUP: PickLevel
EDIT_ACTION_UNSPECIFIED: EditAction
EDIT_ACTION_RECOLOR: EditAction
EDIT_ACTION_REMOVE: EditAction
EDIT_ACTION_MOVE: EditAction
EDIT_ACTION_DUPLICATE: EditAction
EDIT_ACTION_NAME: EditAction
EDIT_ACTION_UNNAME: EditAction
EDIT_ACTION_MERGE: EditAction
EDIT_ACTION_DISCARD: EditAction
EDIT_ACTION_INSERT: EditAction
EDIT_ACTION_SPLIT: EditAction
EDIT_ACTION_ADD: EditAction
EDIT_ACTION_LOOK_AGAIN: EditAction
EDIT_ACTION_SCALE: EditAction
EDIT_ACTION_ALIGN: EditAction
EDIT_ACTION_SUGGEST: EditAction
EDIT_ACTION_OBSERVE: EditAction
OBJECT_SIDE_UNSPECIFIED: ObjectSide
OBJECT_SIDE_LONGEST: ObjectSide
OBJECT_SIDE_HEIGHT: ObjectSide
OUTPUT_UNSPECIFIED: Output
OUTPUT_MASK2D: Output
OUTPUT_MASK3D: Output
OUTPUT_OBJECTS: Output
MASK3D_ENCODING_UNSPECIFIED: Mask3dEncoding
MASK3D_ENCODING_BITS: Mask3dEncoding
MASK3D_ENCODING_RUNS: Mask3dEncoding
MASK3D_ENCODING_INDICES: Mask3dEncoding
MASK3D_ENCODING_PLY: Mask3dEncoding
RELATION_UNSPECIFIED: Relation
RELATION_SAME: Relation
RELATION_KIND_OF: Relation
RELATION_PART_OF: Relation
RELATION_RELATED: Relation
RELATION_ABSENT: Relation
RELATION_UNDECIDED: Relation
RELATION_SUBJECT_UNSPECIFIED: RelationSubject
RELATION_SUBJECT_LABEL: RelationSubject
RELATION_SUBJECT_QUESTION: RelationSubject
ANSWER_METHOD_UNSPECIFIED: AnswerMethod
ANSWER_METHOD_LEXICON: AnswerMethod
ANSWER_METHOD_ENCODER: AnswerMethod
ANSWER_METHOD_NAMES: AnswerMethod
ASKS_UNSPECIFIED: Asks
ASKS_OBJECTS: Asks
ASKS_COUNT: Asks
REFUSAL_REASON_UNSPECIFIED: RefusalReason
REFUSAL_REASON_NOT_UNDERSTOOD: RefusalReason
REFUSAL_REASON_AMBIGUOUS: RefusalReason
REFUSAL_REASON_POSE_NEEDED: RefusalReason
REFUSAL_REASON_VERTICAL_UNKNOWN: RefusalReason
REFUSAL_REASON_TOO_CLOSE: RefusalReason
REFUSAL_REASON_OUT_OF_VIEW: RefusalReason
REFUSAL_REASON_INDIRECT: RefusalReason
REFUSAL_REASON_AMBIGUOUS_REFERENT: RefusalReason
REFUSAL_REASON_REFERENT_ABSENT: RefusalReason
REFUSAL_REASON_NOTHING_TO_COMPARE: RefusalReason
REFUSAL_REASON_NOT_MEASURED: RefusalReason
REFUSAL_REASON_NOT_NAMED: RefusalReason
REFUSAL_REASON_NOT_READ: RefusalReason
OUTCOME_UNSPECIFIED: Outcome
OUTCOME_HERE: Outcome
OUTCOME_PROBABLY_HERE: Outcome
OUTCOME_NOT_HERE: Outcome
OUTCOME_NOT_SEEN: Outcome
OUTCOME_CANNOT_SAY: Outcome
PICTURE_KIND_UNSPECIFIED: PictureKind
PICTURE_KIND_RGB: PictureKind
PICTURE_KIND_OVERLAY: PictureKind
PICTURE_KIND_RELEVANCY: PictureKind
PICTURE_KIND_MASK: PictureKind
PICTURE_KIND_LABEL_MAP: PictureKind
PICTURE_KIND_DEPTH: PictureKind
PICTURE_KIND_DEPTH_PICTURE: PictureKind
PICTURE_KIND_OBJECT_MAP: PictureKind
PICTURE_KIND_OBJECTS: PictureKind
PICTURE_KIND_NORMALS: PictureKind
PICTURE_KIND_CONFIDENCE: PictureKind
PICTURE_FORMAT_UNSPECIFIED: PictureFormat
PICTURE_FORMAT_PNG: PictureFormat
PICTURE_FORMAT_NPY: PictureFormat
PICTURE_FORMAT_JPEG: PictureFormat
EXPORT_FORMAT_UNSPECIFIED: ExportFormat
EXPORT_FORMAT_PLY: ExportFormat
EXPORT_FORMAT_SPZ: ExportFormat
EXPORT_FORMAT_HTML: ExportFormat
EXPORT_FORMAT_POINTS: ExportFormat
EXPORT_FORMAT_MESH: ExportFormat
EXPORT_FORMAT_CAMERAS: ExportFormat
EXPORT_FORMAT_SOG: ExportFormat
EXPORT_FORMAT_MCAP: ExportFormat
EXPORT_FORMAT_MAP: ExportFormat
EXPORT_FORMAT_CAMERA_LIST: ExportFormat
EXPORT_FORMAT_TRANSFORMS: ExportFormat
EXPORT_FORMAT_COLMAP: ExportFormat
EXPORT_FORMAT_OBJECTS: ExportFormat
EXPORT_FORMAT_SPZ4: ExportFormat
NEXT_PHOTO_REASON_UNSPECIFIED: NextPhotoReason
NEXT_PHOTO_REASON_GAP: NextPhotoReason
NEXT_PHOTO_REASON_FEW_DIRECTIONS: NextPhotoReason
NEXT_PHOTO_REASON_HIDDEN: NextPhotoReason
FLOOR_SOURCE_UNSPECIFIED: FloorSource
FLOOR_SOURCE_SURFACE: FloorSource
FLOOR_SOURCE_LOWEST_LEVEL: FloorSource
COVARIANCE_TERM_UNSPECIFIED: CovarianceTerm
COVARIANCE_TERM_EDGES: CovarianceTerm
COVARIANCE_TERM_MEMBERSHIP: CovarianceTerm
COVARIANCE_TERM_SCALE: CovarianceTerm
COVARIANCE_TERM_ALIGNMENT: CovarianceTerm
SUPPORT_RELATION_UNSPECIFIED: SupportRelation
SUPPORT_RELATION_ON: SupportRelation
SUPPORT_RELATION_IN: SupportRelation
LOCALIZE_REFUSAL_UNSPECIFIED: LocalizeRefusal
LOCALIZE_REFUSAL_NO_KEYPOINTS: LocalizeRefusal
LOCALIZE_REFUSAL_FEW_MATCHES: LocalizeRefusal
LOCALIZE_REFUSAL_NARROW: LocalizeRefusal
LOCALIZE_REFUSAL_LOOKS_DIFFERENT: LocalizeRefusal
FOCAL_SOURCE_UNSPECIFIED: FocalSource
FOCAL_SOURCE_GIVEN: FocalSource
FOCAL_SOURCE_METADATA: FocalSource
FOCAL_SOURCE_SCENE: FocalSource
FOCAL_SOURCE_ESTIMATED: FocalSource
DIFFERENCE_KIND_UNSPECIFIED: DifferenceKind
DIFFERENCE_KIND_NEW: DifferenceKind
DIFFERENCE_KIND_MISSING: DifferenceKind
DIFFERENCE_KIND_CHANGED: DifferenceKind
CHANGE_KIND_UNSPECIFIED: ChangeKind
CHANGE_KIND_GONE: ChangeKind
CHANGE_KIND_MOVED: ChangeKind
CHANGE_KIND_NEW: ChangeKind
CHANGE_KIND_CHANGED: ChangeKind
SEEN_AT_SOURCE_UNSPECIFIED: SeenAtSource
SEEN_AT_SOURCE_GIVEN: SeenAtSource
SEEN_AT_SOURCE_METADATA: SeenAtSource
SEEN_AT_SOURCE_RECEIVED: SeenAtSource
ROLE_UNSPECIFIED: Role
ROLE_READER: Role
ROLE_EDITOR: Role
ROLE_ADMIN: Role
ROLE_OPERATOR: Role
ROLE_UPLOADER: Role
ROLE_SUGGESTER: Role
KEY_STATE_UNSPECIFIED: KeyState
KEY_STATE_VALID: KeyState
KEY_STATE_EXPIRED: KeyState
KEY_STATE_REVOKED: KeyState

class CreateSceneHeader(_message.Message):
    __slots__ = ("name", "request_id", "labels", "time_budget_s", "max_gaussians", "preset", "priority", "up", "movers", "privacy", "lens", "nadir_deg", "strict", "tolerance_db")
    NAME_FIELD_NUMBER: _ClassVar[int]
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    LABELS_FIELD_NUMBER: _ClassVar[int]
    TIME_BUDGET_S_FIELD_NUMBER: _ClassVar[int]
    MAX_GAUSSIANS_FIELD_NUMBER: _ClassVar[int]
    PRESET_FIELD_NUMBER: _ClassVar[int]
    PRIORITY_FIELD_NUMBER: _ClassVar[int]
    UP_FIELD_NUMBER: _ClassVar[int]
    MOVERS_FIELD_NUMBER: _ClassVar[int]
    PRIVACY_FIELD_NUMBER: _ClassVar[int]
    LENS_FIELD_NUMBER: _ClassVar[int]
    NADIR_DEG_FIELD_NUMBER: _ClassVar[int]
    STRICT_FIELD_NUMBER: _ClassVar[int]
    TOLERANCE_DB_FIELD_NUMBER: _ClassVar[int]
    name: str
    request_id: str
    labels: _containers.RepeatedScalarFieldContainer[str]
    time_budget_s: float
    max_gaussians: int
    preset: str
    priority: int
    up: str
    movers: str
    privacy: str
    lens: str
    nadir_deg: float
    strict: bool
    tolerance_db: float
    def __init__(self, name: _Optional[str] = ..., request_id: _Optional[str] = ..., labels: _Optional[_Iterable[str]] = ..., time_budget_s: _Optional[float] = ..., max_gaussians: _Optional[int] = ..., preset: _Optional[str] = ..., priority: _Optional[int] = ..., up: _Optional[str] = ..., movers: _Optional[str] = ..., privacy: _Optional[str] = ..., lens: _Optional[str] = ..., nadir_deg: _Optional[float] = ..., strict: _Optional[bool] = ..., tolerance_db: _Optional[float] = ...) -> None: ...

class Operation(_message.Message):
    __slots__ = ("id", "scene_id", "state", "done", "created_at", "updated_at", "stages", "error", "kind", "look_again", "attempt", "worker", "seconds_left", "finish_requested", "preview", "placed", "left_out", "again_after", "draft", "create_scene", "ask_captioner", "jobs_ahead", "starts_in_s", "attempts")
    class LeftOutEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    ID_FIELD_NUMBER: _ClassVar[int]
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    DONE_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_FIELD_NUMBER: _ClassVar[int]
    UPDATED_AT_FIELD_NUMBER: _ClassVar[int]
    STAGES_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    LOOK_AGAIN_FIELD_NUMBER: _ClassVar[int]
    ATTEMPT_FIELD_NUMBER: _ClassVar[int]
    WORKER_FIELD_NUMBER: _ClassVar[int]
    SECONDS_LEFT_FIELD_NUMBER: _ClassVar[int]
    FINISH_REQUESTED_FIELD_NUMBER: _ClassVar[int]
    PREVIEW_FIELD_NUMBER: _ClassVar[int]
    PLACED_FIELD_NUMBER: _ClassVar[int]
    LEFT_OUT_FIELD_NUMBER: _ClassVar[int]
    AGAIN_AFTER_FIELD_NUMBER: _ClassVar[int]
    DRAFT_FIELD_NUMBER: _ClassVar[int]
    CREATE_SCENE_FIELD_NUMBER: _ClassVar[int]
    ASK_CAPTIONER_FIELD_NUMBER: _ClassVar[int]
    JOBS_AHEAD_FIELD_NUMBER: _ClassVar[int]
    STARTS_IN_S_FIELD_NUMBER: _ClassVar[int]
    ATTEMPTS_FIELD_NUMBER: _ClassVar[int]
    id: str
    scene_id: str
    state: OperationState
    done: bool
    created_at: _timestamp_pb2.Timestamp
    updated_at: _timestamp_pb2.Timestamp
    stages: _containers.RepeatedCompositeFieldContainer[StageProgress]
    error: OperationError
    kind: OperationKind
    look_again: LookAgainResult
    attempt: int
    worker: WorkerState
    seconds_left: float
    finish_requested: bool
    preview: PreviewInfo
    placed: PlacedInfo
    left_out: _containers.ScalarMap[str, str]
    again_after: AgainAfter
    draft: DraftInfo
    create_scene: CreateSceneResult
    ask_captioner: CaptionerResult
    jobs_ahead: int
    starts_in_s: float
    attempts: _containers.RepeatedCompositeFieldContainer[JobAttempt]
    def __init__(self, id: _Optional[str] = ..., scene_id: _Optional[str] = ..., state: _Optional[_Union[OperationState, str]] = ..., done: _Optional[bool] = ..., created_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., updated_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., stages: _Optional[_Iterable[_Union[StageProgress, _Mapping]]] = ..., error: _Optional[_Union[OperationError, _Mapping]] = ..., kind: _Optional[_Union[OperationKind, str]] = ..., look_again: _Optional[_Union[LookAgainResult, _Mapping]] = ..., attempt: _Optional[int] = ..., worker: _Optional[_Union[WorkerState, str]] = ..., seconds_left: _Optional[float] = ..., finish_requested: _Optional[bool] = ..., preview: _Optional[_Union[PreviewInfo, _Mapping]] = ..., placed: _Optional[_Union[PlacedInfo, _Mapping]] = ..., left_out: _Optional[_Mapping[str, str]] = ..., again_after: _Optional[_Union[AgainAfter, str]] = ..., draft: _Optional[_Union[DraftInfo, _Mapping]] = ..., create_scene: _Optional[_Union[CreateSceneResult, _Mapping]] = ..., ask_captioner: _Optional[_Union[CaptionerResult, _Mapping]] = ..., jobs_ahead: _Optional[int] = ..., starts_in_s: _Optional[float] = ..., attempts: _Optional[_Iterable[_Union[JobAttempt, _Mapping]]] = ...) -> None: ...

class StageProgress(_message.Message):
    __slots__ = ("stage", "fraction", "message", "seconds", "metrics")
    class MetricsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    STAGE_FIELD_NUMBER: _ClassVar[int]
    FRACTION_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    SECONDS_FIELD_NUMBER: _ClassVar[int]
    METRICS_FIELD_NUMBER: _ClassVar[int]
    stage: str
    fraction: float
    message: str
    seconds: float
    metrics: _containers.ScalarMap[str, float]
    def __init__(self, stage: _Optional[str] = ..., fraction: _Optional[float] = ..., message: _Optional[str] = ..., seconds: _Optional[float] = ..., metrics: _Optional[_Mapping[str, float]] = ...) -> None: ...

class OperationError(_message.Message):
    __slots__ = ("kind", "reason", "message", "stage", "details", "photos", "recurs")
    class DetailsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    KIND_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    STAGE_FIELD_NUMBER: _ClassVar[int]
    DETAILS_FIELD_NUMBER: _ClassVar[int]
    PHOTOS_FIELD_NUMBER: _ClassVar[int]
    RECURS_FIELD_NUMBER: _ClassVar[int]
    kind: str
    reason: str
    message: str
    stage: str
    details: _containers.ScalarMap[str, str]
    photos: _containers.RepeatedScalarFieldContainer[str]
    recurs: bool
    def __init__(self, kind: _Optional[str] = ..., reason: _Optional[str] = ..., message: _Optional[str] = ..., stage: _Optional[str] = ..., details: _Optional[_Mapping[str, str]] = ..., photos: _Optional[_Iterable[str]] = ..., recurs: _Optional[bool] = ...) -> None: ...

class LookAgainResult(_message.Message):
    __slots__ = ("version", "texts", "views", "rendered", "named", "suggested", "regions", "unmatched")
    VERSION_FIELD_NUMBER: _ClassVar[int]
    TEXTS_FIELD_NUMBER: _ClassVar[int]
    VIEWS_FIELD_NUMBER: _ClassVar[int]
    RENDERED_FIELD_NUMBER: _ClassVar[int]
    NAMED_FIELD_NUMBER: _ClassVar[int]
    SUGGESTED_FIELD_NUMBER: _ClassVar[int]
    REGIONS_FIELD_NUMBER: _ClassVar[int]
    UNMATCHED_FIELD_NUMBER: _ClassVar[int]
    version: str
    texts: _containers.RepeatedScalarFieldContainer[str]
    views: _containers.RepeatedScalarFieldContainer[str]
    rendered: bool
    named: _containers.RepeatedCompositeFieldContainer[FoundName]
    suggested: _containers.RepeatedCompositeFieldContainer[FoundName]
    regions: int
    unmatched: int
    def __init__(self, version: _Optional[str] = ..., texts: _Optional[_Iterable[str]] = ..., views: _Optional[_Iterable[str]] = ..., rendered: _Optional[bool] = ..., named: _Optional[_Iterable[_Union[FoundName, _Mapping]]] = ..., suggested: _Optional[_Iterable[_Union[FoundName, _Mapping]]] = ..., regions: _Optional[int] = ..., unmatched: _Optional[int] = ...) -> None: ...

class FoundName(_message.Message):
    __slots__ = ("object_id", "name", "probability")
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    object_id: int
    name: str
    probability: float
    def __init__(self, object_id: _Optional[int] = ..., name: _Optional[str] = ..., probability: _Optional[float] = ...) -> None: ...

class CaptionerResult(_message.Message):
    __slots__ = ("suggested", "objects", "refused", "problem", "version")
    SUGGESTED_FIELD_NUMBER: _ClassVar[int]
    OBJECTS_FIELD_NUMBER: _ClassVar[int]
    REFUSED_FIELD_NUMBER: _ClassVar[int]
    PROBLEM_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    suggested: int
    objects: int
    refused: int
    problem: str
    version: str
    def __init__(self, suggested: _Optional[int] = ..., objects: _Optional[int] = ..., refused: _Optional[int] = ..., problem: _Optional[str] = ..., version: _Optional[str] = ...) -> None: ...

class PreviewInfo(_message.Message):
    __slots__ = ("number", "step", "seconds", "gaussians", "psnr", "view", "width", "height")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    STEP_FIELD_NUMBER: _ClassVar[int]
    SECONDS_FIELD_NUMBER: _ClassVar[int]
    GAUSSIANS_FIELD_NUMBER: _ClassVar[int]
    PSNR_FIELD_NUMBER: _ClassVar[int]
    VIEW_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    number: int
    step: int
    seconds: float
    gaussians: int
    psnr: float
    view: str
    width: int
    height: int
    def __init__(self, number: _Optional[int] = ..., step: _Optional[int] = ..., seconds: _Optional[float] = ..., gaussians: _Optional[int] = ..., psnr: _Optional[float] = ..., view: _Optional[str] = ..., width: _Optional[int] = ..., height: _Optional[int] = ...) -> None: ...

class PlacedInfo(_message.Message):
    __slots__ = ("number", "placed", "images", "complete")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    PLACED_FIELD_NUMBER: _ClassVar[int]
    IMAGES_FIELD_NUMBER: _ClassVar[int]
    COMPLETE_FIELD_NUMBER: _ClassVar[int]
    number: int
    placed: int
    images: int
    complete: bool
    def __init__(self, number: _Optional[int] = ..., placed: _Optional[int] = ..., images: _Optional[int] = ..., complete: _Optional[bool] = ...) -> None: ...

class DraftInfo(_message.Message):
    __slots__ = ("number", "version", "stage", "fraction")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    STAGE_FIELD_NUMBER: _ClassVar[int]
    FRACTION_FIELD_NUMBER: _ClassVar[int]
    number: int
    version: str
    stage: DraftStage
    fraction: float
    def __init__(self, number: _Optional[int] = ..., version: _Optional[str] = ..., stage: _Optional[_Union[DraftStage, str]] = ..., fraction: _Optional[float] = ...) -> None: ...

class CreateSceneResult(_message.Message):
    __slots__ = ("carried", "lost")
    CARRIED_FIELD_NUMBER: _ClassVar[int]
    LOST_FIELD_NUMBER: _ClassVar[int]
    carried: int
    lost: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, carried: _Optional[int] = ..., lost: _Optional[_Iterable[str]] = ...) -> None: ...

class JobAttempt(_message.Message):
    __slots__ = ("number", "worker", "began_at", "ended_at", "why")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    WORKER_FIELD_NUMBER: _ClassVar[int]
    BEGAN_AT_FIELD_NUMBER: _ClassVar[int]
    ENDED_AT_FIELD_NUMBER: _ClassVar[int]
    WHY_FIELD_NUMBER: _ClassVar[int]
    number: int
    worker: str
    began_at: _timestamp_pb2.Timestamp
    ended_at: _timestamp_pb2.Timestamp
    why: AgainAfter
    def __init__(self, number: _Optional[int] = ..., worker: _Optional[str] = ..., began_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., ended_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., why: _Optional[_Union[AgainAfter, str]] = ...) -> None: ...

class OpenSampleRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Scene(_message.Message):
    __slots__ = ("id", "name", "state", "operation_id", "created_at", "gaussians", "scale", "dictionary", "cameras", "quality", "version", "label_count", "camera_count", "assessment", "scaling", "vertical", "alignment", "provisional", "object_count", "captured_at")
    ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    OPERATION_ID_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_FIELD_NUMBER: _ClassVar[int]
    GAUSSIANS_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    DICTIONARY_FIELD_NUMBER: _ClassVar[int]
    CAMERAS_FIELD_NUMBER: _ClassVar[int]
    QUALITY_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    LABEL_COUNT_FIELD_NUMBER: _ClassVar[int]
    CAMERA_COUNT_FIELD_NUMBER: _ClassVar[int]
    ASSESSMENT_FIELD_NUMBER: _ClassVar[int]
    SCALING_FIELD_NUMBER: _ClassVar[int]
    VERTICAL_FIELD_NUMBER: _ClassVar[int]
    ALIGNMENT_FIELD_NUMBER: _ClassVar[int]
    PROVISIONAL_FIELD_NUMBER: _ClassVar[int]
    OBJECT_COUNT_FIELD_NUMBER: _ClassVar[int]
    CAPTURED_AT_FIELD_NUMBER: _ClassVar[int]
    id: str
    name: str
    state: SceneState
    operation_id: str
    created_at: _timestamp_pb2.Timestamp
    gaussians: int
    scale: Scale
    dictionary: _containers.RepeatedCompositeFieldContainer[DictionaryEntry]
    cameras: _containers.RepeatedCompositeFieldContainer[PosedCamera]
    quality: _struct_pb2.Struct
    version: str
    label_count: int
    camera_count: int
    assessment: Assessment
    scaling: SceneScaling
    vertical: SceneVertical
    alignment: SceneAlignment
    provisional: Provisional
    object_count: int
    captured_at: _timestamp_pb2.Timestamp
    def __init__(self, id: _Optional[str] = ..., name: _Optional[str] = ..., state: _Optional[_Union[SceneState, str]] = ..., operation_id: _Optional[str] = ..., created_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., gaussians: _Optional[int] = ..., scale: _Optional[_Union[Scale, str]] = ..., dictionary: _Optional[_Iterable[_Union[DictionaryEntry, _Mapping]]] = ..., cameras: _Optional[_Iterable[_Union[PosedCamera, _Mapping]]] = ..., quality: _Optional[_Union[_struct_pb2.Struct, _Mapping]] = ..., version: _Optional[str] = ..., label_count: _Optional[int] = ..., camera_count: _Optional[int] = ..., assessment: _Optional[_Union[Assessment, _Mapping]] = ..., scaling: _Optional[_Union[SceneScaling, _Mapping]] = ..., vertical: _Optional[_Union[SceneVertical, _Mapping]] = ..., alignment: _Optional[_Union[SceneAlignment, _Mapping]] = ..., provisional: _Optional[_Union[Provisional, _Mapping]] = ..., object_count: _Optional[int] = ..., captured_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ...) -> None: ...

class DictionaryEntry(_message.Message):
    __slots__ = ("label_id", "label", "aliases", "pixels", "views", "gaussian_count")
    LABEL_ID_FIELD_NUMBER: _ClassVar[int]
    LABEL_FIELD_NUMBER: _ClassVar[int]
    ALIASES_FIELD_NUMBER: _ClassVar[int]
    PIXELS_FIELD_NUMBER: _ClassVar[int]
    VIEWS_FIELD_NUMBER: _ClassVar[int]
    GAUSSIAN_COUNT_FIELD_NUMBER: _ClassVar[int]
    label_id: int
    label: str
    aliases: _containers.RepeatedScalarFieldContainer[str]
    pixels: int
    views: int
    gaussian_count: int
    def __init__(self, label_id: _Optional[int] = ..., label: _Optional[str] = ..., aliases: _Optional[_Iterable[str]] = ..., pixels: _Optional[int] = ..., views: _Optional[int] = ..., gaussian_count: _Optional[int] = ...) -> None: ...

class PosedCamera(_message.Message):
    __slots__ = ("intrinsics", "position", "orientation", "convention", "frame_id", "name")
    INTRINSICS_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    ORIENTATION_FIELD_NUMBER: _ClassVar[int]
    CONVENTION_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    intrinsics: Intrinsics
    position: Vector3
    orientation: Quaternion
    convention: Convention
    frame_id: str
    name: str
    def __init__(self, intrinsics: _Optional[_Union[Intrinsics, _Mapping]] = ..., position: _Optional[_Union[Vector3, _Mapping]] = ..., orientation: _Optional[_Union[Quaternion, _Mapping]] = ..., convention: _Optional[_Union[Convention, str]] = ..., frame_id: _Optional[str] = ..., name: _Optional[str] = ...) -> None: ...

class Intrinsics(_message.Message):
    __slots__ = ("width", "height", "fx", "fy", "cx", "cy")
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    FX_FIELD_NUMBER: _ClassVar[int]
    FY_FIELD_NUMBER: _ClassVar[int]
    CX_FIELD_NUMBER: _ClassVar[int]
    CY_FIELD_NUMBER: _ClassVar[int]
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    def __init__(self, width: _Optional[int] = ..., height: _Optional[int] = ..., fx: _Optional[float] = ..., fy: _Optional[float] = ..., cx: _Optional[float] = ..., cy: _Optional[float] = ...) -> None: ...

class Vector3(_message.Message):
    __slots__ = ("x", "y", "z")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    z: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ...) -> None: ...

class Quaternion(_message.Message):
    __slots__ = ("x", "y", "z", "w")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    W_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    z: float
    w: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., w: _Optional[float] = ...) -> None: ...

class Assessment(_message.Message):
    __slots__ = ("grade", "findings")
    GRADE_FIELD_NUMBER: _ClassVar[int]
    FINDINGS_FIELD_NUMBER: _ClassVar[int]
    grade: Grade
    findings: _containers.RepeatedCompositeFieldContainer[Finding]
    def __init__(self, grade: _Optional[_Union[Grade, str]] = ..., findings: _Optional[_Iterable[_Union[Finding, _Mapping]]] = ...) -> None: ...

class Finding(_message.Message):
    __slots__ = ("reason", "grade", "message", "advice")
    REASON_FIELD_NUMBER: _ClassVar[int]
    GRADE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    ADVICE_FIELD_NUMBER: _ClassVar[int]
    reason: str
    grade: Grade
    message: str
    advice: str
    def __init__(self, reason: _Optional[str] = ..., grade: _Optional[_Union[Grade, str]] = ..., message: _Optional[str] = ..., advice: _Optional[str] = ...) -> None: ...

class SceneScaling(_message.Message):
    __slots__ = ("source", "meters_per_unit", "low", "high", "known_lengths")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    METERS_PER_UNIT_FIELD_NUMBER: _ClassVar[int]
    LOW_FIELD_NUMBER: _ClassVar[int]
    HIGH_FIELD_NUMBER: _ClassVar[int]
    KNOWN_LENGTHS_FIELD_NUMBER: _ClassVar[int]
    source: ScaleSource
    meters_per_unit: float
    low: float
    high: float
    known_lengths: int
    def __init__(self, source: _Optional[_Union[ScaleSource, str]] = ..., meters_per_unit: _Optional[float] = ..., low: _Optional[float] = ..., high: _Optional[float] = ..., known_lengths: _Optional[int] = ...) -> None: ...

class SceneVertical(_message.Message):
    __slots__ = ("source", "deviation_deg", "up")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    DEVIATION_DEG_FIELD_NUMBER: _ClassVar[int]
    UP_FIELD_NUMBER: _ClassVar[int]
    source: VerticalSource
    deviation_deg: float
    up: Vector3
    def __init__(self, source: _Optional[_Union[VerticalSource, str]] = ..., deviation_deg: _Optional[float] = ..., up: _Optional[_Union[Vector3, _Mapping]] = ...) -> None: ...

class SceneAlignment(_message.Message):
    __slots__ = ("frame", "pairs", "rms", "residuals", "outliers", "transform")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    PAIRS_FIELD_NUMBER: _ClassVar[int]
    RMS_FIELD_NUMBER: _ClassVar[int]
    RESIDUALS_FIELD_NUMBER: _ClassVar[int]
    OUTLIERS_FIELD_NUMBER: _ClassVar[int]
    TRANSFORM_FIELD_NUMBER: _ClassVar[int]
    frame: str
    pairs: int
    rms: float
    residuals: _containers.RepeatedScalarFieldContainer[float]
    outliers: _containers.RepeatedScalarFieldContainer[int]
    transform: Pose
    def __init__(self, frame: _Optional[str] = ..., pairs: _Optional[int] = ..., rms: _Optional[float] = ..., residuals: _Optional[_Iterable[float]] = ..., outliers: _Optional[_Iterable[int]] = ..., transform: _Optional[_Union[Pose, _Mapping]] = ...) -> None: ...

class Pose(_message.Message):
    __slots__ = ("position", "orientation")
    POSITION_FIELD_NUMBER: _ClassVar[int]
    ORIENTATION_FIELD_NUMBER: _ClassVar[int]
    position: Vector3
    orientation: Quaternion
    def __init__(self, position: _Optional[_Union[Vector3, _Mapping]] = ..., orientation: _Optional[_Union[Quaternion, _Mapping]] = ...) -> None: ...

class Provisional(_message.Message):
    __slots__ = ("stage", "fraction")
    STAGE_FIELD_NUMBER: _ClassVar[int]
    FRACTION_FIELD_NUMBER: _ClassVar[int]
    stage: DraftStage
    fraction: float
    def __init__(self, stage: _Optional[_Union[DraftStage, str]] = ..., fraction: _Optional[float] = ...) -> None: ...

class GetSceneRequest(_message.Message):
    __slots__ = ("scene_id",)
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    def __init__(self, scene_id: _Optional[str] = ...) -> None: ...

class ListScenesRequest(_message.Message):
    __slots__ = ("page_size", "page_token")
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    page_size: int
    page_token: str
    def __init__(self, page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListScenesResponse(_message.Message):
    __slots__ = ("scenes", "next_page_token")
    SCENES_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    scenes: _containers.RepeatedCompositeFieldContainer[Scene]
    next_page_token: str
    def __init__(self, scenes: _Optional[_Iterable[_Union[Scene, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class UpdateSceneRequest(_message.Message):
    __slots__ = ("scene_id", "name", "expected_name")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    EXPECTED_NAME_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    name: str
    expected_name: str
    def __init__(self, scene_id: _Optional[str] = ..., name: _Optional[str] = ..., expected_name: _Optional[str] = ...) -> None: ...

class DeleteSceneRequest(_message.Message):
    __slots__ = ("scene_id",)
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    def __init__(self, scene_id: _Optional[str] = ...) -> None: ...

class ListPhotoVerdictsRequest(_message.Message):
    __slots__ = ("scene_id", "page_size", "page_token")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    page_size: int
    page_token: str
    def __init__(self, scene_id: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListPhotoVerdictsResponse(_message.Message):
    __slots__ = ("photos", "next_page_token", "assessed", "placed_count", "photo_count")
    PHOTOS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    ASSESSED_FIELD_NUMBER: _ClassVar[int]
    PLACED_COUNT_FIELD_NUMBER: _ClassVar[int]
    PHOTO_COUNT_FIELD_NUMBER: _ClassVar[int]
    photos: _containers.RepeatedCompositeFieldContainer[PhotoVerdict]
    next_page_token: str
    assessed: bool
    placed_count: int
    photo_count: int
    def __init__(self, photos: _Optional[_Iterable[_Union[PhotoVerdict, _Mapping]]] = ..., next_page_token: _Optional[str] = ..., assessed: _Optional[bool] = ..., placed_count: _Optional[int] = ..., photo_count: _Optional[int] = ...) -> None: ...

class PhotoVerdict(_message.Message):
    __slots__ = ("name", "placed", "not_placed", "defects", "duplicate_of", "sharpness", "brightness", "matches", "advice", "withheld", "between", "exposure_ev", "red_ev", "blue_ev")
    NAME_FIELD_NUMBER: _ClassVar[int]
    PLACED_FIELD_NUMBER: _ClassVar[int]
    NOT_PLACED_FIELD_NUMBER: _ClassVar[int]
    DEFECTS_FIELD_NUMBER: _ClassVar[int]
    DUPLICATE_OF_FIELD_NUMBER: _ClassVar[int]
    SHARPNESS_FIELD_NUMBER: _ClassVar[int]
    BRIGHTNESS_FIELD_NUMBER: _ClassVar[int]
    MATCHES_FIELD_NUMBER: _ClassVar[int]
    ADVICE_FIELD_NUMBER: _ClassVar[int]
    WITHHELD_FIELD_NUMBER: _ClassVar[int]
    BETWEEN_FIELD_NUMBER: _ClassVar[int]
    EXPOSURE_EV_FIELD_NUMBER: _ClassVar[int]
    RED_EV_FIELD_NUMBER: _ClassVar[int]
    BLUE_EV_FIELD_NUMBER: _ClassVar[int]
    name: str
    placed: bool
    not_placed: NotPlaced
    defects: _containers.RepeatedScalarFieldContainer[PhotoDefect]
    duplicate_of: str
    sharpness: float
    brightness: float
    matches: int
    advice: str
    withheld: float
    between: _containers.RepeatedScalarFieldContainer[str]
    exposure_ev: float
    red_ev: float
    blue_ev: float
    def __init__(self, name: _Optional[str] = ..., placed: _Optional[bool] = ..., not_placed: _Optional[_Union[NotPlaced, str]] = ..., defects: _Optional[_Iterable[_Union[PhotoDefect, str]]] = ..., duplicate_of: _Optional[str] = ..., sharpness: _Optional[float] = ..., brightness: _Optional[float] = ..., matches: _Optional[int] = ..., advice: _Optional[str] = ..., withheld: _Optional[float] = ..., between: _Optional[_Iterable[str]] = ..., exposure_ev: _Optional[float] = ..., red_ev: _Optional[float] = ..., blue_ev: _Optional[float] = ...) -> None: ...

class ListLabelsRequest(_message.Message):
    __slots__ = ("scene_id", "page_size", "page_token")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    page_size: int
    page_token: str
    def __init__(self, scene_id: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListLabelsResponse(_message.Message):
    __slots__ = ("labels", "next_page_token")
    LABELS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    labels: _containers.RepeatedCompositeFieldContainer[DictionaryEntry]
    next_page_token: str
    def __init__(self, labels: _Optional[_Iterable[_Union[DictionaryEntry, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class ListObjectsRequest(_message.Message):
    __slots__ = ("scene_id", "version", "page_size", "page_token", "parts")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    version: str
    page_size: int
    page_token: str
    parts: bool
    def __init__(self, scene_id: _Optional[str] = ..., version: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ..., parts: _Optional[bool] = ...) -> None: ...

class ListObjectsResponse(_message.Message):
    __slots__ = ("objects", "next_page_token", "version")
    OBJECTS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    objects: _containers.RepeatedCompositeFieldContainer[SceneObject]
    next_page_token: str
    version: str
    def __init__(self, objects: _Optional[_Iterable[_Union[SceneObject, _Mapping]]] = ..., next_page_token: _Optional[str] = ..., version: _Optional[str] = ...) -> None: ...

class SceneObject(_message.Message):
    __slots__ = ("id", "name", "source", "probability", "suggestions", "kind", "surface", "consensus", "gaussian_count", "box", "meters", "parent", "parts", "centroid", "guess", "groups", "reads", "last_seen", "missing_since", "seen_in", "label_id", "best_views")
    ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    SUGGESTIONS_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    SURFACE_FIELD_NUMBER: _ClassVar[int]
    CONSENSUS_FIELD_NUMBER: _ClassVar[int]
    GAUSSIAN_COUNT_FIELD_NUMBER: _ClassVar[int]
    BOX_FIELD_NUMBER: _ClassVar[int]
    METERS_FIELD_NUMBER: _ClassVar[int]
    PARENT_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    CENTROID_FIELD_NUMBER: _ClassVar[int]
    GUESS_FIELD_NUMBER: _ClassVar[int]
    GROUPS_FIELD_NUMBER: _ClassVar[int]
    READS_FIELD_NUMBER: _ClassVar[int]
    LAST_SEEN_FIELD_NUMBER: _ClassVar[int]
    MISSING_SINCE_FIELD_NUMBER: _ClassVar[int]
    SEEN_IN_FIELD_NUMBER: _ClassVar[int]
    LABEL_ID_FIELD_NUMBER: _ClassVar[int]
    BEST_VIEWS_FIELD_NUMBER: _ClassVar[int]
    id: int
    name: str
    source: NameSource
    probability: float
    suggestions: _containers.RepeatedCompositeFieldContainer[NameSuggestion]
    kind: ObjectKind
    surface: str
    consensus: float
    gaussian_count: int
    box: Box
    meters: bool
    parent: int
    parts: _containers.RepeatedScalarFieldContainer[int]
    centroid: Vector3
    guess: bool
    groups: _containers.RepeatedScalarFieldContainer[int]
    reads: _containers.RepeatedCompositeFieldContainer[ObjectRead]
    last_seen: _timestamp_pb2.Timestamp
    missing_since: _timestamp_pb2.Timestamp
    seen_in: str
    label_id: int
    best_views: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, id: _Optional[int] = ..., name: _Optional[str] = ..., source: _Optional[_Union[NameSource, str]] = ..., probability: _Optional[float] = ..., suggestions: _Optional[_Iterable[_Union[NameSuggestion, _Mapping]]] = ..., kind: _Optional[_Union[ObjectKind, str]] = ..., surface: _Optional[str] = ..., consensus: _Optional[float] = ..., gaussian_count: _Optional[int] = ..., box: _Optional[_Union[Box, _Mapping]] = ..., meters: _Optional[bool] = ..., parent: _Optional[int] = ..., parts: _Optional[_Iterable[int]] = ..., centroid: _Optional[_Union[Vector3, _Mapping]] = ..., guess: _Optional[bool] = ..., groups: _Optional[_Iterable[int]] = ..., reads: _Optional[_Iterable[_Union[ObjectRead, _Mapping]]] = ..., last_seen: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., missing_since: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., seen_in: _Optional[str] = ..., label_id: _Optional[int] = ..., best_views: _Optional[_Iterable[str]] = ...) -> None: ...

class NameSuggestion(_message.Message):
    __slots__ = ("name", "probability", "scene_id", "aliases", "said_by")
    NAME_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    ALIASES_FIELD_NUMBER: _ClassVar[int]
    SAID_BY_FIELD_NUMBER: _ClassVar[int]
    name: str
    probability: float
    scene_id: str
    aliases: _containers.RepeatedScalarFieldContainer[str]
    said_by: _containers.RepeatedCompositeFieldContainer[SuggestionSource]
    def __init__(self, name: _Optional[str] = ..., probability: _Optional[float] = ..., scene_id: _Optional[str] = ..., aliases: _Optional[_Iterable[str]] = ..., said_by: _Optional[_Iterable[_Union[SuggestionSource, _Mapping]]] = ...) -> None: ...

class SuggestionSource(_message.Message):
    __slots__ = ("source", "model", "probability")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    source: str
    model: str
    probability: float
    def __init__(self, source: _Optional[str] = ..., model: _Optional[str] = ..., probability: _Optional[float] = ...) -> None: ...

class Box(_message.Message):
    __slots__ = ("center", "size")
    CENTER_FIELD_NUMBER: _ClassVar[int]
    SIZE_FIELD_NUMBER: _ClassVar[int]
    center: Pose
    size: Vector3
    def __init__(self, center: _Optional[_Union[Pose, _Mapping]] = ..., size: _Optional[_Union[Vector3, _Mapping]] = ...) -> None: ...

class ObjectRead(_message.Message):
    __slots__ = ("kind", "text", "probability", "views")
    KIND_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    VIEWS_FIELD_NUMBER: _ClassVar[int]
    kind: ReadKind
    text: str
    probability: float
    views: int
    def __init__(self, kind: _Optional[_Union[ReadKind, str]] = ..., text: _Optional[str] = ..., probability: _Optional[float] = ..., views: _Optional[int] = ...) -> None: ...

class PickObjectRequest(_message.Message):
    __slots__ = ("scene_id", "camera", "view", "pixel", "box", "point", "version", "mask2d_encoding", "level", "mask3d")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    VIEW_FIELD_NUMBER: _ClassVar[int]
    PIXEL_FIELD_NUMBER: _ClassVar[int]
    BOX_FIELD_NUMBER: _ClassVar[int]
    POINT_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    MASK2D_ENCODING_FIELD_NUMBER: _ClassVar[int]
    LEVEL_FIELD_NUMBER: _ClassVar[int]
    MASK3D_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    camera: PosedCamera
    view: str
    pixel: Pixel
    box: PixelBox
    point: Vector3
    version: str
    mask2d_encoding: MaskEncoding
    level: AskedLevel
    mask3d: bool
    def __init__(self, scene_id: _Optional[str] = ..., camera: _Optional[_Union[PosedCamera, _Mapping]] = ..., view: _Optional[str] = ..., pixel: _Optional[_Union[Pixel, _Mapping]] = ..., box: _Optional[_Union[PixelBox, _Mapping]] = ..., point: _Optional[_Union[Vector3, _Mapping]] = ..., version: _Optional[str] = ..., mask2d_encoding: _Optional[_Union[MaskEncoding, str]] = ..., level: _Optional[_Union[AskedLevel, str]] = ..., mask3d: _Optional[bool] = ...) -> None: ...

class Pixel(_message.Message):
    __slots__ = ("x", "y")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ...) -> None: ...

class PixelBox(_message.Message):
    __slots__ = ("left", "top", "right", "bottom")
    LEFT_FIELD_NUMBER: _ClassVar[int]
    TOP_FIELD_NUMBER: _ClassVar[int]
    RIGHT_FIELD_NUMBER: _ClassVar[int]
    BOTTOM_FIELD_NUMBER: _ClassVar[int]
    left: float
    top: float
    right: float
    bottom: float
    def __init__(self, left: _Optional[float] = ..., top: _Optional[float] = ..., right: _Optional[float] = ..., bottom: _Optional[float] = ...) -> None: ...

class PickedObject(_message.Message):
    __slots__ = ("object", "mask", "version", "part", "levels", "level", "mask3d", "provisional")
    OBJECT_FIELD_NUMBER: _ClassVar[int]
    MASK_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    PART_FIELD_NUMBER: _ClassVar[int]
    LEVELS_FIELD_NUMBER: _ClassVar[int]
    LEVEL_FIELD_NUMBER: _ClassVar[int]
    MASK3D_FIELD_NUMBER: _ClassVar[int]
    PROVISIONAL_FIELD_NUMBER: _ClassVar[int]
    object: SceneObject
    mask: ViewMask
    version: str
    part: SceneObject
    levels: _containers.RepeatedCompositeFieldContainer[PickedLevel]
    level: PickLevel
    mask3d: bytes
    provisional: Provisional
    def __init__(self, object: _Optional[_Union[SceneObject, _Mapping]] = ..., mask: _Optional[_Union[ViewMask, _Mapping]] = ..., version: _Optional[str] = ..., part: _Optional[_Union[SceneObject, _Mapping]] = ..., levels: _Optional[_Iterable[_Union[PickedLevel, _Mapping]]] = ..., level: _Optional[_Union[PickLevel, str]] = ..., mask3d: _Optional[bytes] = ..., provisional: _Optional[_Union[Provisional, _Mapping]] = ...) -> None: ...

class ViewMask(_message.Message):
    __slots__ = ("view", "camera_index", "segmentation", "area", "continues", "png")
    VIEW_FIELD_NUMBER: _ClassVar[int]
    CAMERA_INDEX_FIELD_NUMBER: _ClassVar[int]
    SEGMENTATION_FIELD_NUMBER: _ClassVar[int]
    AREA_FIELD_NUMBER: _ClassVar[int]
    CONTINUES_FIELD_NUMBER: _ClassVar[int]
    PNG_FIELD_NUMBER: _ClassVar[int]
    view: str
    camera_index: int
    segmentation: Segmentation
    area: int
    continues: bool
    png: bytes
    def __init__(self, view: _Optional[str] = ..., camera_index: _Optional[int] = ..., segmentation: _Optional[_Union[Segmentation, _Mapping]] = ..., area: _Optional[int] = ..., continues: _Optional[bool] = ..., png: _Optional[bytes] = ...) -> None: ...

class Segmentation(_message.Message):
    __slots__ = ("size", "counts")
    SIZE_FIELD_NUMBER: _ClassVar[int]
    COUNTS_FIELD_NUMBER: _ClassVar[int]
    size: _containers.RepeatedScalarFieldContainer[int]
    counts: str
    def __init__(self, size: _Optional[_Iterable[int]] = ..., counts: _Optional[str] = ...) -> None: ...

class PickedLevel(_message.Message):
    __slots__ = ("level", "id", "members", "probability")
    LEVEL_FIELD_NUMBER: _ClassVar[int]
    ID_FIELD_NUMBER: _ClassVar[int]
    MEMBERS_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    level: PickLevel
    id: int
    members: _containers.RepeatedScalarFieldContainer[int]
    probability: float
    def __init__(self, level: _Optional[_Union[PickLevel, str]] = ..., id: _Optional[int] = ..., members: _Optional[_Iterable[int]] = ..., probability: _Optional[float] = ...) -> None: ...

class MeasureRequest(_message.Message):
    __slots__ = ("scene_id", "places", "version")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    PLACES_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    places: _containers.RepeatedCompositeFieldContainer[Place]
    version: str
    def __init__(self, scene_id: _Optional[str] = ..., places: _Optional[_Iterable[_Union[Place, _Mapping]]] = ..., version: _Optional[str] = ...) -> None: ...

class Place(_message.Message):
    __slots__ = ("camera", "view", "pixel", "point", "object_id")
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    VIEW_FIELD_NUMBER: _ClassVar[int]
    PIXEL_FIELD_NUMBER: _ClassVar[int]
    POINT_FIELD_NUMBER: _ClassVar[int]
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    camera: PosedCamera
    view: str
    pixel: Pixel
    point: Vector3
    object_id: int
    def __init__(self, camera: _Optional[_Union[PosedCamera, _Mapping]] = ..., view: _Optional[str] = ..., pixel: _Optional[_Union[Pixel, _Mapping]] = ..., point: _Optional[_Union[Vector3, _Mapping]] = ..., object_id: _Optional[int] = ...) -> None: ...

class Measurement(_message.Message):
    __slots__ = ("places", "distance", "center_distance", "sides", "box", "meters", "version")
    PLACES_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_FIELD_NUMBER: _ClassVar[int]
    CENTER_DISTANCE_FIELD_NUMBER: _ClassVar[int]
    SIDES_FIELD_NUMBER: _ClassVar[int]
    BOX_FIELD_NUMBER: _ClassVar[int]
    METERS_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    places: _containers.RepeatedCompositeFieldContainer[LocatedPlace]
    distance: Length
    center_distance: Length
    sides: _containers.RepeatedCompositeFieldContainer[Length]
    box: Box
    meters: bool
    version: str
    def __init__(self, places: _Optional[_Iterable[_Union[LocatedPlace, _Mapping]]] = ..., distance: _Optional[_Union[Length, _Mapping]] = ..., center_distance: _Optional[_Union[Length, _Mapping]] = ..., sides: _Optional[_Iterable[_Union[Length, _Mapping]]] = ..., box: _Optional[_Union[Box, _Mapping]] = ..., meters: _Optional[bool] = ..., version: _Optional[str] = ...) -> None: ...

class LocatedPlace(_message.Message):
    __slots__ = ("point", "plus_minus", "object_id")
    POINT_FIELD_NUMBER: _ClassVar[int]
    PLUS_MINUS_FIELD_NUMBER: _ClassVar[int]
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    point: Vector3
    plus_minus: float
    object_id: int
    def __init__(self, point: _Optional[_Union[Vector3, _Mapping]] = ..., plus_minus: _Optional[float] = ..., object_id: _Optional[int] = ...) -> None: ...

class Length(_message.Message):
    __slots__ = ("value", "low", "high")
    VALUE_FIELD_NUMBER: _ClassVar[int]
    LOW_FIELD_NUMBER: _ClassVar[int]
    HIGH_FIELD_NUMBER: _ClassVar[int]
    value: float
    low: float
    high: float
    def __init__(self, value: _Optional[float] = ..., low: _Optional[float] = ..., high: _Optional[float] = ...) -> None: ...

class EditSceneRequest(_message.Message):
    __slots__ = ("scene_id", "edits", "request_id", "version")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    EDITS_FIELD_NUMBER: _ClassVar[int]
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    edits: _containers.RepeatedCompositeFieldContainer[Edit]
    request_id: str
    version: str
    def __init__(self, scene_id: _Optional[str] = ..., edits: _Optional[_Iterable[_Union[Edit, _Mapping]]] = ..., request_id: _Optional[str] = ..., version: _Optional[str] = ...) -> None: ...

class Edit(_message.Message):
    __slots__ = ("action", "label", "color", "transform", "object_ids", "name", "aliases", "source", "prompt", "texts", "known_lengths", "known_sizes", "alignment", "kinds", "filter", "suggestions")
    ACTION_FIELD_NUMBER: _ClassVar[int]
    LABEL_FIELD_NUMBER: _ClassVar[int]
    COLOR_FIELD_NUMBER: _ClassVar[int]
    TRANSFORM_FIELD_NUMBER: _ClassVar[int]
    OBJECT_IDS_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    ALIASES_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    PROMPT_FIELD_NUMBER: _ClassVar[int]
    TEXTS_FIELD_NUMBER: _ClassVar[int]
    KNOWN_LENGTHS_FIELD_NUMBER: _ClassVar[int]
    KNOWN_SIZES_FIELD_NUMBER: _ClassVar[int]
    ALIGNMENT_FIELD_NUMBER: _ClassVar[int]
    KINDS_FIELD_NUMBER: _ClassVar[int]
    FILTER_FIELD_NUMBER: _ClassVar[int]
    SUGGESTIONS_FIELD_NUMBER: _ClassVar[int]
    action: EditAction
    label: str
    color: Color
    transform: Pose
    object_ids: _containers.RepeatedScalarFieldContainer[int]
    name: str
    aliases: _containers.RepeatedScalarFieldContainer[str]
    source: InsertSource
    prompt: ObjectPrompt
    texts: _containers.RepeatedScalarFieldContainer[str]
    known_lengths: _containers.RepeatedCompositeFieldContainer[KnownLength]
    known_sizes: _containers.RepeatedCompositeFieldContainer[KnownSize]
    alignment: Alignment
    kinds: _containers.RepeatedScalarFieldContainer[str]
    filter: GaussianFilter
    suggestions: _containers.RepeatedCompositeFieldContainer[SuggestedName]
    def __init__(self, action: _Optional[_Union[EditAction, str]] = ..., label: _Optional[str] = ..., color: _Optional[_Union[Color, _Mapping]] = ..., transform: _Optional[_Union[Pose, _Mapping]] = ..., object_ids: _Optional[_Iterable[int]] = ..., name: _Optional[str] = ..., aliases: _Optional[_Iterable[str]] = ..., source: _Optional[_Union[InsertSource, _Mapping]] = ..., prompt: _Optional[_Union[ObjectPrompt, _Mapping]] = ..., texts: _Optional[_Iterable[str]] = ..., known_lengths: _Optional[_Iterable[_Union[KnownLength, _Mapping]]] = ..., known_sizes: _Optional[_Iterable[_Union[KnownSize, _Mapping]]] = ..., alignment: _Optional[_Union[Alignment, _Mapping]] = ..., kinds: _Optional[_Iterable[str]] = ..., filter: _Optional[_Union[GaussianFilter, _Mapping]] = ..., suggestions: _Optional[_Iterable[_Union[SuggestedName, _Mapping]]] = ...) -> None: ...

class Color(_message.Message):
    __slots__ = ("r", "g", "b")
    R_FIELD_NUMBER: _ClassVar[int]
    G_FIELD_NUMBER: _ClassVar[int]
    B_FIELD_NUMBER: _ClassVar[int]
    r: float
    g: float
    b: float
    def __init__(self, r: _Optional[float] = ..., g: _Optional[float] = ..., b: _Optional[float] = ...) -> None: ...

class InsertSource(_message.Message):
    __slots__ = ("scene_id", "version")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    version: str
    def __init__(self, scene_id: _Optional[str] = ..., version: _Optional[str] = ...) -> None: ...

class ObjectPrompt(_message.Message):
    __slots__ = ("camera", "view", "pixels", "background", "box")
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    VIEW_FIELD_NUMBER: _ClassVar[int]
    PIXELS_FIELD_NUMBER: _ClassVar[int]
    BACKGROUND_FIELD_NUMBER: _ClassVar[int]
    BOX_FIELD_NUMBER: _ClassVar[int]
    camera: PosedCamera
    view: str
    pixels: _containers.RepeatedCompositeFieldContainer[Pixel]
    background: _containers.RepeatedCompositeFieldContainer[Pixel]
    box: PixelBox
    def __init__(self, camera: _Optional[_Union[PosedCamera, _Mapping]] = ..., view: _Optional[str] = ..., pixels: _Optional[_Iterable[_Union[Pixel, _Mapping]]] = ..., background: _Optional[_Iterable[_Union[Pixel, _Mapping]]] = ..., box: _Optional[_Union[PixelBox, _Mapping]] = ...) -> None: ...

class KnownLength(_message.Message):
    __slots__ = ("first", "second", "meters", "plus_minus")
    FIRST_FIELD_NUMBER: _ClassVar[int]
    SECOND_FIELD_NUMBER: _ClassVar[int]
    METERS_FIELD_NUMBER: _ClassVar[int]
    PLUS_MINUS_FIELD_NUMBER: _ClassVar[int]
    first: Place
    second: Place
    meters: float
    plus_minus: float
    def __init__(self, first: _Optional[_Union[Place, _Mapping]] = ..., second: _Optional[_Union[Place, _Mapping]] = ..., meters: _Optional[float] = ..., plus_minus: _Optional[float] = ...) -> None: ...

class KnownSize(_message.Message):
    __slots__ = ("object_id", "meters", "plus_minus", "side")
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    METERS_FIELD_NUMBER: _ClassVar[int]
    PLUS_MINUS_FIELD_NUMBER: _ClassVar[int]
    SIDE_FIELD_NUMBER: _ClassVar[int]
    object_id: int
    meters: float
    plus_minus: float
    side: ObjectSide
    def __init__(self, object_id: _Optional[int] = ..., meters: _Optional[float] = ..., plus_minus: _Optional[float] = ..., side: _Optional[_Union[ObjectSide, str]] = ...) -> None: ...

class Alignment(_message.Message):
    __slots__ = ("frame", "transform", "pairs")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    TRANSFORM_FIELD_NUMBER: _ClassVar[int]
    PAIRS_FIELD_NUMBER: _ClassVar[int]
    frame: str
    transform: Pose
    pairs: _containers.RepeatedCompositeFieldContainer[PointPair]
    def __init__(self, frame: _Optional[str] = ..., transform: _Optional[_Union[Pose, _Mapping]] = ..., pairs: _Optional[_Iterable[_Union[PointPair, _Mapping]]] = ...) -> None: ...

class PointPair(_message.Message):
    __slots__ = ("scene", "map")
    SCENE_FIELD_NUMBER: _ClassVar[int]
    MAP_FIELD_NUMBER: _ClassVar[int]
    scene: Vector3
    map: Vector3
    def __init__(self, scene: _Optional[_Union[Vector3, _Mapping]] = ..., map: _Optional[_Union[Vector3, _Mapping]] = ...) -> None: ...

class GaussianFilter(_message.Message):
    __slots__ = ("box", "outside", "opacity_below", "isolation_above")
    BOX_FIELD_NUMBER: _ClassVar[int]
    OUTSIDE_FIELD_NUMBER: _ClassVar[int]
    OPACITY_BELOW_FIELD_NUMBER: _ClassVar[int]
    ISOLATION_ABOVE_FIELD_NUMBER: _ClassVar[int]
    box: Box
    outside: bool
    opacity_below: float
    isolation_above: float
    def __init__(self, box: _Optional[_Union[Box, _Mapping]] = ..., outside: _Optional[bool] = ..., opacity_below: _Optional[float] = ..., isolation_above: _Optional[float] = ...) -> None: ...

class SuggestedName(_message.Message):
    __slots__ = ("object_id", "name", "probability", "source", "model", "aliases")
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    ALIASES_FIELD_NUMBER: _ClassVar[int]
    object_id: int
    name: str
    probability: float
    source: str
    model: str
    aliases: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, object_id: _Optional[int] = ..., name: _Optional[str] = ..., probability: _Optional[float] = ..., source: _Optional[str] = ..., model: _Optional[str] = ..., aliases: _Optional[_Iterable[str]] = ...) -> None: ...

class SceneVersion(_message.Message):
    __slots__ = ("scene_id", "version", "parent", "created_at", "gaussians", "current", "edits", "prompted", "author", "asks_kind")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    PARENT_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_FIELD_NUMBER: _ClassVar[int]
    GAUSSIANS_FIELD_NUMBER: _ClassVar[int]
    CURRENT_FIELD_NUMBER: _ClassVar[int]
    EDITS_FIELD_NUMBER: _ClassVar[int]
    PROMPTED_FIELD_NUMBER: _ClassVar[int]
    AUTHOR_FIELD_NUMBER: _ClassVar[int]
    ASKS_KIND_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    version: str
    parent: str
    created_at: _timestamp_pb2.Timestamp
    gaussians: int
    current: bool
    edits: _containers.RepeatedCompositeFieldContainer[Edit]
    prompted: _containers.RepeatedCompositeFieldContainer[PromptedObject]
    author: str
    asks_kind: bool
    def __init__(self, scene_id: _Optional[str] = ..., version: _Optional[str] = ..., parent: _Optional[str] = ..., created_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., gaussians: _Optional[int] = ..., current: _Optional[bool] = ..., edits: _Optional[_Iterable[_Union[Edit, _Mapping]]] = ..., prompted: _Optional[_Iterable[_Union[PromptedObject, _Mapping]]] = ..., author: _Optional[str] = ..., asks_kind: _Optional[bool] = ...) -> None: ...

class PromptedObject(_message.Message):
    __slots__ = ("edit", "object_id", "gaussian_count", "views")
    EDIT_FIELD_NUMBER: _ClassVar[int]
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    GAUSSIAN_COUNT_FIELD_NUMBER: _ClassVar[int]
    VIEWS_FIELD_NUMBER: _ClassVar[int]
    edit: int
    object_id: int
    gaussian_count: int
    views: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, edit: _Optional[int] = ..., object_id: _Optional[int] = ..., gaussian_count: _Optional[int] = ..., views: _Optional[_Iterable[str]] = ...) -> None: ...

class PreviewEditRequest(_message.Message):
    __slots__ = ("scene_id", "edits", "version")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    EDITS_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    edits: _containers.RepeatedCompositeFieldContainer[Edit]
    version: str
    def __init__(self, scene_id: _Optional[str] = ..., edits: _Optional[_Iterable[_Union[Edit, _Mapping]]] = ..., version: _Optional[str] = ...) -> None: ...

class EditPreview(_message.Message):
    __slots__ = ("version", "gaussians", "count", "counts", "mask3d")
    VERSION_FIELD_NUMBER: _ClassVar[int]
    GAUSSIANS_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    COUNTS_FIELD_NUMBER: _ClassVar[int]
    MASK3D_FIELD_NUMBER: _ClassVar[int]
    version: str
    gaussians: int
    count: int
    counts: _containers.RepeatedScalarFieldContainer[int]
    mask3d: bytes
    def __init__(self, version: _Optional[str] = ..., gaussians: _Optional[int] = ..., count: _Optional[int] = ..., counts: _Optional[_Iterable[int]] = ..., mask3d: _Optional[bytes] = ...) -> None: ...

class SuggestNamesRequest(_message.Message):
    __slots__ = ("scene_id", "suggestions", "request_id")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    SUGGESTIONS_FIELD_NUMBER: _ClassVar[int]
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    suggestions: _containers.RepeatedCompositeFieldContainer[SuggestedName]
    request_id: str
    def __init__(self, scene_id: _Optional[str] = ..., suggestions: _Optional[_Iterable[_Union[SuggestedName, _Mapping]]] = ..., request_id: _Optional[str] = ...) -> None: ...

class AskCaptionerRequest(_message.Message):
    __slots__ = ("scene_id", "request_id")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    request_id: str
    def __init__(self, scene_id: _Optional[str] = ..., request_id: _Optional[str] = ...) -> None: ...

class UndoEditRequest(_message.Message):
    __slots__ = ("scene_id", "version")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    version: str
    def __init__(self, scene_id: _Optional[str] = ..., version: _Optional[str] = ...) -> None: ...

class RedoEditRequest(_message.Message):
    __slots__ = ("scene_id", "version")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    version: str
    def __init__(self, scene_id: _Optional[str] = ..., version: _Optional[str] = ...) -> None: ...

class RestoreVersionRequest(_message.Message):
    __slots__ = ("scene_id", "version", "expected")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    EXPECTED_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    version: str
    expected: str
    def __init__(self, scene_id: _Optional[str] = ..., version: _Optional[str] = ..., expected: _Optional[str] = ...) -> None: ...

class ListVersionsRequest(_message.Message):
    __slots__ = ("scene_id",)
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    def __init__(self, scene_id: _Optional[str] = ...) -> None: ...

class ListVersionsResponse(_message.Message):
    __slots__ = ("versions",)
    VERSIONS_FIELD_NUMBER: _ClassVar[int]
    versions: _containers.RepeatedCompositeFieldContainer[SceneVersion]
    def __init__(self, versions: _Optional[_Iterable[_Union[SceneVersion, _Mapping]]] = ...) -> None: ...

class LookAgainRequest(_message.Message):
    __slots__ = ("scene_id", "texts", "request_id")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    TEXTS_FIELD_NUMBER: _ClassVar[int]
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    texts: _containers.RepeatedScalarFieldContainer[str]
    request_id: str
    def __init__(self, scene_id: _Optional[str] = ..., texts: _Optional[_Iterable[str]] = ..., request_id: _Optional[str] = ...) -> None: ...

class GetOperationRequest(_message.Message):
    __slots__ = ("operation_id",)
    OPERATION_ID_FIELD_NUMBER: _ClassVar[int]
    operation_id: str
    def __init__(self, operation_id: _Optional[str] = ...) -> None: ...

class ListOperationsRequest(_message.Message):
    __slots__ = ("page_size", "page_token", "state")
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    page_size: int
    page_token: str
    state: OperationState
    def __init__(self, page_size: _Optional[int] = ..., page_token: _Optional[str] = ..., state: _Optional[_Union[OperationState, str]] = ...) -> None: ...

class ListOperationsResponse(_message.Message):
    __slots__ = ("operations", "next_page_token")
    OPERATIONS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    operations: _containers.RepeatedCompositeFieldContainer[Operation]
    next_page_token: str
    def __init__(self, operations: _Optional[_Iterable[_Union[Operation, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class CancelOperationRequest(_message.Message):
    __slots__ = ("operation_id",)
    OPERATION_ID_FIELD_NUMBER: _ClassVar[int]
    operation_id: str
    def __init__(self, operation_id: _Optional[str] = ...) -> None: ...

class RetryOperationRequest(_message.Message):
    __slots__ = ("operation_id", "exclude")
    OPERATION_ID_FIELD_NUMBER: _ClassVar[int]
    EXCLUDE_FIELD_NUMBER: _ClassVar[int]
    operation_id: str
    exclude: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, operation_id: _Optional[str] = ..., exclude: _Optional[_Iterable[str]] = ...) -> None: ...

class FinishOperationRequest(_message.Message):
    __slots__ = ("operation_id",)
    OPERATION_ID_FIELD_NUMBER: _ClassVar[int]
    operation_id: str
    def __init__(self, operation_id: _Optional[str] = ...) -> None: ...

class GetPreviewRequest(_message.Message):
    __slots__ = ("operation_id",)
    OPERATION_ID_FIELD_NUMBER: _ClassVar[int]
    operation_id: str
    def __init__(self, operation_id: _Optional[str] = ...) -> None: ...

class Preview(_message.Message):
    __slots__ = ("info", "picture")
    INFO_FIELD_NUMBER: _ClassVar[int]
    PICTURE_FIELD_NUMBER: _ClassVar[int]
    info: PreviewInfo
    picture: bytes
    def __init__(self, info: _Optional[_Union[PreviewInfo, _Mapping]] = ..., picture: _Optional[bytes] = ...) -> None: ...

class GetPlacedCamerasRequest(_message.Message):
    __slots__ = ("operation_id",)
    OPERATION_ID_FIELD_NUMBER: _ClassVar[int]
    operation_id: str
    def __init__(self, operation_id: _Optional[str] = ...) -> None: ...

class PlacedCameras(_message.Message):
    __slots__ = ("info", "cameras", "points", "colors")
    INFO_FIELD_NUMBER: _ClassVar[int]
    CAMERAS_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    COLORS_FIELD_NUMBER: _ClassVar[int]
    info: PlacedInfo
    cameras: _containers.RepeatedCompositeFieldContainer[PosedCamera]
    points: bytes
    colors: bytes
    def __init__(self, info: _Optional[_Union[PlacedInfo, _Mapping]] = ..., cameras: _Optional[_Iterable[_Union[PosedCamera, _Mapping]]] = ..., points: _Optional[bytes] = ..., colors: _Optional[bytes] = ...) -> None: ...

class GetJobLogRequest(_message.Message):
    __slots__ = ("operation_id",)
    OPERATION_ID_FIELD_NUMBER: _ClassVar[int]
    operation_id: str
    def __init__(self, operation_id: _Optional[str] = ...) -> None: ...

class JobLog(_message.Message):
    __slots__ = ("log",)
    LOG_FIELD_NUMBER: _ClassVar[int]
    log: str
    def __init__(self, log: _Optional[str] = ...) -> None: ...

class WaitOperationRequest(_message.Message):
    __slots__ = ("operation_id", "timeout_s")
    OPERATION_ID_FIELD_NUMBER: _ClassVar[int]
    TIMEOUT_S_FIELD_NUMBER: _ClassVar[int]
    operation_id: str
    timeout_s: float
    def __init__(self, operation_id: _Optional[str] = ..., timeout_s: _Optional[float] = ...) -> None: ...

class WatchOperationRequest(_message.Message):
    __slots__ = ("operation_id",)
    OPERATION_ID_FIELD_NUMBER: _ClassVar[int]
    operation_id: str
    def __init__(self, operation_id: _Optional[str] = ...) -> None: ...

class QueryRequest(_message.Message):
    __slots__ = ("scene_id", "texts", "cameras", "views", "outputs", "version", "negatives", "templates", "coverage", "max_matches", "mask2d_encoding", "mask3d_encoding", "asker", "asker_view")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    TEXTS_FIELD_NUMBER: _ClassVar[int]
    CAMERAS_FIELD_NUMBER: _ClassVar[int]
    VIEWS_FIELD_NUMBER: _ClassVar[int]
    OUTPUTS_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    NEGATIVES_FIELD_NUMBER: _ClassVar[int]
    TEMPLATES_FIELD_NUMBER: _ClassVar[int]
    COVERAGE_FIELD_NUMBER: _ClassVar[int]
    MAX_MATCHES_FIELD_NUMBER: _ClassVar[int]
    MASK2D_ENCODING_FIELD_NUMBER: _ClassVar[int]
    MASK3D_ENCODING_FIELD_NUMBER: _ClassVar[int]
    ASKER_FIELD_NUMBER: _ClassVar[int]
    ASKER_VIEW_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    texts: _containers.RepeatedScalarFieldContainer[str]
    cameras: _containers.RepeatedCompositeFieldContainer[PosedCamera]
    views: _containers.RepeatedScalarFieldContainer[str]
    outputs: _containers.RepeatedScalarFieldContainer[Output]
    version: str
    negatives: _containers.RepeatedScalarFieldContainer[str]
    templates: _containers.RepeatedScalarFieldContainer[str]
    coverage: float
    max_matches: int
    mask2d_encoding: MaskEncoding
    mask3d_encoding: Mask3dEncoding
    asker: Pose
    asker_view: str
    def __init__(self, scene_id: _Optional[str] = ..., texts: _Optional[_Iterable[str]] = ..., cameras: _Optional[_Iterable[_Union[PosedCamera, _Mapping]]] = ..., views: _Optional[_Iterable[str]] = ..., outputs: _Optional[_Iterable[_Union[Output, str]]] = ..., version: _Optional[str] = ..., negatives: _Optional[_Iterable[str]] = ..., templates: _Optional[_Iterable[str]] = ..., coverage: _Optional[float] = ..., max_matches: _Optional[int] = ..., mask2d_encoding: _Optional[_Union[MaskEncoding, str]] = ..., mask3d_encoding: _Optional[_Union[Mask3dEncoding, str]] = ..., asker: _Optional[_Union[Pose, _Mapping]] = ..., asker_view: _Optional[str] = ...) -> None: ...

class Answer(_message.Message):
    __slots__ = ("scene_id", "text", "matches", "probability", "label_set", "coverage", "version", "match_count", "gaussians", "presence", "object_ids", "searched", "relation", "relation_subject", "method", "phrase", "outcome", "sentence", "provisional", "noun_phrase")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    MATCHES_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    LABEL_SET_FIELD_NUMBER: _ClassVar[int]
    COVERAGE_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    MATCH_COUNT_FIELD_NUMBER: _ClassVar[int]
    GAUSSIANS_FIELD_NUMBER: _ClassVar[int]
    PRESENCE_FIELD_NUMBER: _ClassVar[int]
    OBJECT_IDS_FIELD_NUMBER: _ClassVar[int]
    SEARCHED_FIELD_NUMBER: _ClassVar[int]
    RELATION_FIELD_NUMBER: _ClassVar[int]
    RELATION_SUBJECT_FIELD_NUMBER: _ClassVar[int]
    METHOD_FIELD_NUMBER: _ClassVar[int]
    PHRASE_FIELD_NUMBER: _ClassVar[int]
    OUTCOME_FIELD_NUMBER: _ClassVar[int]
    SENTENCE_FIELD_NUMBER: _ClassVar[int]
    PROVISIONAL_FIELD_NUMBER: _ClassVar[int]
    NOUN_PHRASE_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    text: str
    matches: _containers.RepeatedCompositeFieldContainer[Match]
    probability: float
    label_set: _containers.RepeatedScalarFieldContainer[int]
    coverage: float
    version: str
    match_count: int
    gaussians: int
    presence: float
    object_ids: _containers.RepeatedScalarFieldContainer[int]
    searched: Searched
    relation: Relation
    relation_subject: RelationSubject
    method: AnswerMethod
    phrase: PhraseAnswer
    outcome: Outcome
    sentence: str
    provisional: Provisional
    noun_phrase: str
    def __init__(self, scene_id: _Optional[str] = ..., text: _Optional[str] = ..., matches: _Optional[_Iterable[_Union[Match, _Mapping]]] = ..., probability: _Optional[float] = ..., label_set: _Optional[_Iterable[int]] = ..., coverage: _Optional[float] = ..., version: _Optional[str] = ..., match_count: _Optional[int] = ..., gaussians: _Optional[int] = ..., presence: _Optional[float] = ..., object_ids: _Optional[_Iterable[int]] = ..., searched: _Optional[_Union[Searched, _Mapping]] = ..., relation: _Optional[_Union[Relation, str]] = ..., relation_subject: _Optional[_Union[RelationSubject, str]] = ..., method: _Optional[_Union[AnswerMethod, str]] = ..., phrase: _Optional[_Union[PhraseAnswer, _Mapping]] = ..., outcome: _Optional[_Union[Outcome, str]] = ..., sentence: _Optional[str] = ..., provisional: _Optional[_Union[Provisional, _Mapping]] = ..., noun_phrase: _Optional[str] = ...) -> None: ...

class Match(_message.Message):
    __slots__ = ("label_id", "label", "relevancy", "similarity", "nearest_negative", "gaussian_count", "relevant", "probability")
    LABEL_ID_FIELD_NUMBER: _ClassVar[int]
    LABEL_FIELD_NUMBER: _ClassVar[int]
    RELEVANCY_FIELD_NUMBER: _ClassVar[int]
    SIMILARITY_FIELD_NUMBER: _ClassVar[int]
    NEAREST_NEGATIVE_FIELD_NUMBER: _ClassVar[int]
    GAUSSIAN_COUNT_FIELD_NUMBER: _ClassVar[int]
    RELEVANT_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    label_id: int
    label: str
    relevancy: float
    similarity: float
    nearest_negative: str
    gaussian_count: int
    relevant: bool
    probability: float
    def __init__(self, label_id: _Optional[int] = ..., label: _Optional[str] = ..., relevancy: _Optional[float] = ..., similarity: _Optional[float] = ..., nearest_negative: _Optional[str] = ..., gaussian_count: _Optional[int] = ..., relevant: _Optional[bool] = ..., probability: _Optional[float] = ...) -> None: ...

class Searched(_message.Message):
    __slots__ = ("named_objects", "unnamed_objects", "unnamed", "names")
    NAMED_OBJECTS_FIELD_NUMBER: _ClassVar[int]
    UNNAMED_OBJECTS_FIELD_NUMBER: _ClassVar[int]
    UNNAMED_FIELD_NUMBER: _ClassVar[int]
    NAMES_FIELD_NUMBER: _ClassVar[int]
    named_objects: int
    unnamed_objects: int
    unnamed: _containers.RepeatedScalarFieldContainer[int]
    names: int
    def __init__(self, named_objects: _Optional[int] = ..., unnamed_objects: _Optional[int] = ..., unnamed: _Optional[_Iterable[int]] = ..., names: _Optional[int] = ...) -> None: ...

class PhraseAnswer(_message.Message):
    __slots__ = ("asks", "head", "conditions", "not_understood", "object_ids", "undecided", "witnesses", "count", "refusal")
    ASKS_FIELD_NUMBER: _ClassVar[int]
    HEAD_FIELD_NUMBER: _ClassVar[int]
    CONDITIONS_FIELD_NUMBER: _ClassVar[int]
    NOT_UNDERSTOOD_FIELD_NUMBER: _ClassVar[int]
    OBJECT_IDS_FIELD_NUMBER: _ClassVar[int]
    UNDECIDED_FIELD_NUMBER: _ClassVar[int]
    WITNESSES_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    REFUSAL_FIELD_NUMBER: _ClassVar[int]
    asks: Asks
    head: str
    conditions: _containers.RepeatedScalarFieldContainer[str]
    not_understood: str
    object_ids: _containers.RepeatedScalarFieldContainer[int]
    undecided: _containers.RepeatedScalarFieldContainer[int]
    witnesses: _containers.RepeatedCompositeFieldContainer[Witness]
    count: int
    refusal: Refusal
    def __init__(self, asks: _Optional[_Union[Asks, str]] = ..., head: _Optional[str] = ..., conditions: _Optional[_Iterable[str]] = ..., not_understood: _Optional[str] = ..., object_ids: _Optional[_Iterable[int]] = ..., undecided: _Optional[_Iterable[int]] = ..., witnesses: _Optional[_Iterable[_Union[Witness, _Mapping]]] = ..., count: _Optional[int] = ..., refusal: _Optional[_Union[Refusal, _Mapping]] = ...) -> None: ...

class Witness(_message.Message):
    __slots__ = ("condition", "object_id", "compared_ids", "measure", "value", "unit", "clearness")
    CONDITION_FIELD_NUMBER: _ClassVar[int]
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    COMPARED_IDS_FIELD_NUMBER: _ClassVar[int]
    MEASURE_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    CLEARNESS_FIELD_NUMBER: _ClassVar[int]
    condition: str
    object_id: int
    compared_ids: _containers.RepeatedScalarFieldContainer[int]
    measure: str
    value: float
    unit: str
    clearness: float
    def __init__(self, condition: _Optional[str] = ..., object_id: _Optional[int] = ..., compared_ids: _Optional[_Iterable[int]] = ..., measure: _Optional[str] = ..., value: _Optional[float] = ..., unit: _Optional[str] = ..., clearness: _Optional[float] = ...) -> None: ...

class Refusal(_message.Message):
    __slots__ = ("reason", "part")
    REASON_FIELD_NUMBER: _ClassVar[int]
    PART_FIELD_NUMBER: _ClassVar[int]
    reason: RefusalReason
    part: str
    def __init__(self, reason: _Optional[_Union[RefusalReason, str]] = ..., part: _Optional[str] = ...) -> None: ...

class SkippedScene(_message.Message):
    __slots__ = ("scene_id", "reason", "detail")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    reason: str
    detail: str
    def __init__(self, scene_id: _Optional[str] = ..., reason: _Optional[str] = ..., detail: _Optional[str] = ...) -> None: ...

class RenderViewRequest(_message.Message):
    __slots__ = ("scene_id", "kind", "text", "camera", "view", "version", "format", "depth_scale", "tints", "dimming", "coarse")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    VIEW_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    DEPTH_SCALE_FIELD_NUMBER: _ClassVar[int]
    TINTS_FIELD_NUMBER: _ClassVar[int]
    DIMMING_FIELD_NUMBER: _ClassVar[int]
    COARSE_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    kind: PictureKind
    text: str
    camera: PosedCamera
    view: str
    version: str
    format: PictureFormat
    depth_scale: float
    tints: _containers.RepeatedCompositeFieldContainer[Tint]
    dimming: float
    coarse: bool
    def __init__(self, scene_id: _Optional[str] = ..., kind: _Optional[_Union[PictureKind, str]] = ..., text: _Optional[str] = ..., camera: _Optional[_Union[PosedCamera, _Mapping]] = ..., view: _Optional[str] = ..., version: _Optional[str] = ..., format: _Optional[_Union[PictureFormat, str]] = ..., depth_scale: _Optional[float] = ..., tints: _Optional[_Iterable[_Union[Tint, _Mapping]]] = ..., dimming: _Optional[float] = ..., coarse: _Optional[bool] = ...) -> None: ...

class Tint(_message.Message):
    __slots__ = ("object_ids", "color", "strength")
    OBJECT_IDS_FIELD_NUMBER: _ClassVar[int]
    COLOR_FIELD_NUMBER: _ClassVar[int]
    STRENGTH_FIELD_NUMBER: _ClassVar[int]
    object_ids: _containers.RepeatedScalarFieldContainer[int]
    color: Color
    strength: float
    def __init__(self, object_ids: _Optional[_Iterable[int]] = ..., color: _Optional[_Union[Color, _Mapping]] = ..., strength: _Optional[float] = ...) -> None: ...

class ExportSceneRequest(_message.Message):
    __slots__ = ("scene_id", "format", "version", "object_ids", "cell", "coarse")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    OBJECT_IDS_FIELD_NUMBER: _ClassVar[int]
    CELL_FIELD_NUMBER: _ClassVar[int]
    COARSE_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    format: ExportFormat
    version: str
    object_ids: _containers.RepeatedScalarFieldContainer[int]
    cell: float
    coarse: bool
    def __init__(self, scene_id: _Optional[str] = ..., format: _Optional[_Union[ExportFormat, str]] = ..., version: _Optional[str] = ..., object_ids: _Optional[_Iterable[int]] = ..., cell: _Optional[float] = ..., coarse: _Optional[bool] = ...) -> None: ...

class ListPhotosRequest(_message.Message):
    __slots__ = ("scene_id", "version", "page_size", "page_token")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    version: str
    page_size: int
    page_token: str
    def __init__(self, scene_id: _Optional[str] = ..., version: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListPhotosResponse(_message.Message):
    __slots__ = ("photos", "next_page_token", "version")
    PHOTOS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    photos: _containers.RepeatedCompositeFieldContainer[ScenePhoto]
    next_page_token: str
    version: str
    def __init__(self, photos: _Optional[_Iterable[_Union[ScenePhoto, _Mapping]]] = ..., next_page_token: _Optional[str] = ..., version: _Optional[str] = ...) -> None: ...

class ScenePhoto(_message.Message):
    __slots__ = ("view", "size_bytes")
    VIEW_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    view: str
    size_bytes: int
    def __init__(self, view: _Optional[str] = ..., size_bytes: _Optional[int] = ...) -> None: ...

class DownloadPhotoRequest(_message.Message):
    __slots__ = ("scene_id", "view", "version")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    VIEW_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    view: str
    version: str
    def __init__(self, scene_id: _Optional[str] = ..., view: _Optional[str] = ..., version: _Optional[str] = ...) -> None: ...

class ListNextPhotosRequest(_message.Message):
    __slots__ = ("scene_id", "version")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    version: str
    def __init__(self, scene_id: _Optional[str] = ..., version: _Optional[str] = ...) -> None: ...

class ListNextPhotosResponse(_message.Message):
    __slots__ = ("photos", "version")
    PHOTOS_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    photos: _containers.RepeatedCompositeFieldContainer[NextPhoto]
    version: str
    def __init__(self, photos: _Optional[_Iterable[_Union[NextPhoto, _Mapping]]] = ..., version: _Optional[str] = ...) -> None: ...

class NextPhoto(_message.Message):
    __slots__ = ("camera", "near", "reason", "advice")
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    NEAR_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    ADVICE_FIELD_NUMBER: _ClassVar[int]
    camera: PosedCamera
    near: str
    reason: NextPhotoReason
    advice: str
    def __init__(self, camera: _Optional[_Union[PosedCamera, _Mapping]] = ..., near: _Optional[str] = ..., reason: _Optional[_Union[NextPhotoReason, str]] = ..., advice: _Optional[str] = ...) -> None: ...

class GetGoalRequest(_message.Message):
    __slots__ = ("scene_id", "object_id", "robot_radius", "version")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    ROBOT_RADIUS_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    object_id: int
    robot_radius: float
    version: str
    def __init__(self, scene_id: _Optional[str] = ..., object_id: _Optional[int] = ..., robot_radius: _Optional[float] = ..., version: _Optional[str] = ...) -> None: ...

class Goal(_message.Message):
    __slots__ = ("pose", "yaw", "distance", "clearance", "object_id", "version", "floor_source")
    POSE_FIELD_NUMBER: _ClassVar[int]
    YAW_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_FIELD_NUMBER: _ClassVar[int]
    CLEARANCE_FIELD_NUMBER: _ClassVar[int]
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    FLOOR_SOURCE_FIELD_NUMBER: _ClassVar[int]
    pose: Pose
    yaw: float
    distance: float
    clearance: float
    object_id: int
    version: str
    floor_source: FloorSource
    def __init__(self, pose: _Optional[_Union[Pose, _Mapping]] = ..., yaw: _Optional[float] = ..., distance: _Optional[float] = ..., clearance: _Optional[float] = ..., object_id: _Optional[int] = ..., version: _Optional[str] = ..., floor_source: _Optional[_Union[FloorSource, str]] = ...) -> None: ...

class ListDetectionsRequest(_message.Message):
    __slots__ = ("scene_id", "version", "page_size", "page_token")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    version: str
    page_size: int
    page_token: str
    def __init__(self, scene_id: _Optional[str] = ..., version: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListDetectionsResponse(_message.Message):
    __slots__ = ("detections", "next_page_token", "version", "frame_id", "meters", "up")
    DETECTIONS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    FRAME_ID_FIELD_NUMBER: _ClassVar[int]
    METERS_FIELD_NUMBER: _ClassVar[int]
    UP_FIELD_NUMBER: _ClassVar[int]
    detections: _containers.RepeatedCompositeFieldContainer[Detection]
    next_page_token: str
    version: str
    frame_id: str
    meters: bool
    up: Vector3
    def __init__(self, detections: _Optional[_Iterable[_Union[Detection, _Mapping]]] = ..., next_page_token: _Optional[str] = ..., version: _Optional[str] = ..., frame_id: _Optional[str] = ..., meters: _Optional[bool] = ..., up: _Optional[_Union[Vector3, _Mapping]] = ...) -> None: ...

class Detection(_message.Message):
    __slots__ = ("object_id", "label", "source", "probability", "alternatives", "kind", "box", "position_covariance", "rotation_covariance", "covariance_terms", "support", "views", "proposed_in", "missed_in", "consensus", "first_seen", "last_seen")
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    LABEL_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    ALTERNATIVES_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    BOX_FIELD_NUMBER: _ClassVar[int]
    POSITION_COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    ROTATION_COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_TERMS_FIELD_NUMBER: _ClassVar[int]
    SUPPORT_FIELD_NUMBER: _ClassVar[int]
    VIEWS_FIELD_NUMBER: _ClassVar[int]
    PROPOSED_IN_FIELD_NUMBER: _ClassVar[int]
    MISSED_IN_FIELD_NUMBER: _ClassVar[int]
    CONSENSUS_FIELD_NUMBER: _ClassVar[int]
    FIRST_SEEN_FIELD_NUMBER: _ClassVar[int]
    LAST_SEEN_FIELD_NUMBER: _ClassVar[int]
    object_id: int
    label: str
    source: NameSource
    probability: float
    alternatives: _containers.RepeatedCompositeFieldContainer[NameSuggestion]
    kind: ObjectKind
    box: Box
    position_covariance: _containers.RepeatedScalarFieldContainer[float]
    rotation_covariance: _containers.RepeatedScalarFieldContainer[float]
    covariance_terms: _containers.RepeatedScalarFieldContainer[CovarianceTerm]
    support: Support
    views: _containers.RepeatedScalarFieldContainer[str]
    proposed_in: _containers.RepeatedScalarFieldContainer[str]
    missed_in: _containers.RepeatedScalarFieldContainer[str]
    consensus: float
    first_seen: _timestamp_pb2.Timestamp
    last_seen: _timestamp_pb2.Timestamp
    def __init__(self, object_id: _Optional[int] = ..., label: _Optional[str] = ..., source: _Optional[_Union[NameSource, str]] = ..., probability: _Optional[float] = ..., alternatives: _Optional[_Iterable[_Union[NameSuggestion, _Mapping]]] = ..., kind: _Optional[_Union[ObjectKind, str]] = ..., box: _Optional[_Union[Box, _Mapping]] = ..., position_covariance: _Optional[_Iterable[float]] = ..., rotation_covariance: _Optional[_Iterable[float]] = ..., covariance_terms: _Optional[_Iterable[_Union[CovarianceTerm, str]]] = ..., support: _Optional[_Union[Support, _Mapping]] = ..., views: _Optional[_Iterable[str]] = ..., proposed_in: _Optional[_Iterable[str]] = ..., missed_in: _Optional[_Iterable[str]] = ..., consensus: _Optional[float] = ..., first_seen: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., last_seen: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ...) -> None: ...

class Support(_message.Message):
    __slots__ = ("object_id", "label", "relation", "clearness")
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    LABEL_FIELD_NUMBER: _ClassVar[int]
    RELATION_FIELD_NUMBER: _ClassVar[int]
    CLEARNESS_FIELD_NUMBER: _ClassVar[int]
    object_id: int
    label: str
    relation: SupportRelation
    clearness: float
    def __init__(self, object_id: _Optional[int] = ..., label: _Optional[str] = ..., relation: _Optional[_Union[SupportRelation, str]] = ..., clearness: _Optional[float] = ...) -> None: ...

class LocalizeRequest(_message.Message):
    __slots__ = ("scene_id", "photos", "focals", "poses", "version")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    PHOTOS_FIELD_NUMBER: _ClassVar[int]
    FOCALS_FIELD_NUMBER: _ClassVar[int]
    POSES_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    photos: _containers.RepeatedScalarFieldContainer[bytes]
    focals: _containers.RepeatedScalarFieldContainer[float]
    poses: _containers.RepeatedCompositeFieldContainer[Pose]
    version: str
    def __init__(self, scene_id: _Optional[str] = ..., photos: _Optional[_Iterable[bytes]] = ..., focals: _Optional[_Iterable[float]] = ..., poses: _Optional[_Iterable[_Union[Pose, _Mapping]]] = ..., version: _Optional[str] = ...) -> None: ...

class Localization(_message.Message):
    __slots__ = ("photos", "meters", "version", "changes", "looked_at")
    PHOTOS_FIELD_NUMBER: _ClassVar[int]
    METERS_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    CHANGES_FIELD_NUMBER: _ClassVar[int]
    LOOKED_AT_FIELD_NUMBER: _ClassVar[int]
    photos: _containers.RepeatedCompositeFieldContainer[LocalizedPhoto]
    meters: bool
    version: str
    changes: _containers.RepeatedCompositeFieldContainer[SceneChange]
    looked_at: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, photos: _Optional[_Iterable[_Union[LocalizedPhoto, _Mapping]]] = ..., meters: _Optional[bool] = ..., version: _Optional[str] = ..., changes: _Optional[_Iterable[_Union[SceneChange, _Mapping]]] = ..., looked_at: _Optional[_Iterable[int]] = ...) -> None: ...

class LocalizedPhoto(_message.Message):
    __slots__ = ("refusal", "explanation", "camera", "covariance", "focal_source", "inliers", "inlier_share", "spread", "agreement", "refined", "objects", "differences", "radial")
    REFUSAL_FIELD_NUMBER: _ClassVar[int]
    EXPLANATION_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    FOCAL_SOURCE_FIELD_NUMBER: _ClassVar[int]
    INLIERS_FIELD_NUMBER: _ClassVar[int]
    INLIER_SHARE_FIELD_NUMBER: _ClassVar[int]
    SPREAD_FIELD_NUMBER: _ClassVar[int]
    AGREEMENT_FIELD_NUMBER: _ClassVar[int]
    REFINED_FIELD_NUMBER: _ClassVar[int]
    OBJECTS_FIELD_NUMBER: _ClassVar[int]
    DIFFERENCES_FIELD_NUMBER: _ClassVar[int]
    RADIAL_FIELD_NUMBER: _ClassVar[int]
    refusal: LocalizeRefusal
    explanation: str
    camera: PosedCamera
    covariance: _containers.RepeatedScalarFieldContainer[float]
    focal_source: FocalSource
    inliers: int
    inlier_share: float
    spread: float
    agreement: float
    refined: bool
    objects: _containers.RepeatedCompositeFieldContainer[ObjectInView]
    differences: _containers.RepeatedCompositeFieldContainer[PhotoDifference]
    radial: float
    def __init__(self, refusal: _Optional[_Union[LocalizeRefusal, str]] = ..., explanation: _Optional[str] = ..., camera: _Optional[_Union[PosedCamera, _Mapping]] = ..., covariance: _Optional[_Iterable[float]] = ..., focal_source: _Optional[_Union[FocalSource, str]] = ..., inliers: _Optional[int] = ..., inlier_share: _Optional[float] = ..., spread: _Optional[float] = ..., agreement: _Optional[float] = ..., refined: _Optional[bool] = ..., objects: _Optional[_Iterable[_Union[ObjectInView, _Mapping]]] = ..., differences: _Optional[_Iterable[_Union[PhotoDifference, _Mapping]]] = ..., radial: _Optional[float] = ...) -> None: ...

class ObjectInView(_message.Message):
    __slots__ = ("object_id", "name", "share", "box")
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    SHARE_FIELD_NUMBER: _ClassVar[int]
    BOX_FIELD_NUMBER: _ClassVar[int]
    object_id: int
    name: str
    share: float
    box: PixelBox
    def __init__(self, object_id: _Optional[int] = ..., name: _Optional[str] = ..., share: _Optional[float] = ..., box: _Optional[_Union[PixelBox, _Mapping]] = ...) -> None: ...

class PhotoDifference(_message.Message):
    __slots__ = ("kind", "box", "strength")
    KIND_FIELD_NUMBER: _ClassVar[int]
    BOX_FIELD_NUMBER: _ClassVar[int]
    STRENGTH_FIELD_NUMBER: _ClassVar[int]
    kind: DifferenceKind
    box: PixelBox
    strength: float
    def __init__(self, kind: _Optional[_Union[DifferenceKind, str]] = ..., box: _Optional[_Union[PixelBox, _Mapping]] = ..., strength: _Optional[float] = ...) -> None: ...

class SceneChange(_message.Message):
    __slots__ = ("kind", "object_id", "name", "probability", "distance", "before", "after", "photos", "sentence")
    KIND_FIELD_NUMBER: _ClassVar[int]
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_FIELD_NUMBER: _ClassVar[int]
    BEFORE_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    PHOTOS_FIELD_NUMBER: _ClassVar[int]
    SENTENCE_FIELD_NUMBER: _ClassVar[int]
    kind: ChangeKind
    object_id: int
    name: str
    probability: float
    distance: float
    before: Box
    after: Box
    photos: _containers.RepeatedScalarFieldContainer[int]
    sentence: str
    def __init__(self, kind: _Optional[_Union[ChangeKind, str]] = ..., object_id: _Optional[int] = ..., name: _Optional[str] = ..., probability: _Optional[float] = ..., distance: _Optional[float] = ..., before: _Optional[_Union[Box, _Mapping]] = ..., after: _Optional[_Union[Box, _Mapping]] = ..., photos: _Optional[_Iterable[int]] = ..., sentence: _Optional[str] = ...) -> None: ...

class ObserveSceneRequest(_message.Message):
    __slots__ = ("scene_id", "photos", "focals", "poses", "seen_at", "request_id")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    PHOTOS_FIELD_NUMBER: _ClassVar[int]
    FOCALS_FIELD_NUMBER: _ClassVar[int]
    POSES_FIELD_NUMBER: _ClassVar[int]
    SEEN_AT_FIELD_NUMBER: _ClassVar[int]
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    photos: _containers.RepeatedScalarFieldContainer[bytes]
    focals: _containers.RepeatedScalarFieldContainer[float]
    poses: _containers.RepeatedCompositeFieldContainer[Pose]
    seen_at: _timestamp_pb2.Timestamp
    request_id: str
    def __init__(self, scene_id: _Optional[str] = ..., photos: _Optional[_Iterable[bytes]] = ..., focals: _Optional[_Iterable[float]] = ..., poses: _Optional[_Iterable[_Union[Pose, _Mapping]]] = ..., seen_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., request_id: _Optional[str] = ...) -> None: ...

class Observation(_message.Message):
    __slots__ = ("scene_id", "id", "seen_at", "seen_at_source", "photos", "left_out", "changes", "looked_at", "meters", "sentence")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    ID_FIELD_NUMBER: _ClassVar[int]
    SEEN_AT_FIELD_NUMBER: _ClassVar[int]
    SEEN_AT_SOURCE_FIELD_NUMBER: _ClassVar[int]
    PHOTOS_FIELD_NUMBER: _ClassVar[int]
    LEFT_OUT_FIELD_NUMBER: _ClassVar[int]
    CHANGES_FIELD_NUMBER: _ClassVar[int]
    LOOKED_AT_FIELD_NUMBER: _ClassVar[int]
    METERS_FIELD_NUMBER: _ClassVar[int]
    SENTENCE_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    id: str
    seen_at: _timestamp_pb2.Timestamp
    seen_at_source: SeenAtSource
    photos: _containers.RepeatedCompositeFieldContainer[ObservedPhoto]
    left_out: _containers.RepeatedScalarFieldContainer[str]
    changes: _containers.RepeatedCompositeFieldContainer[SceneChange]
    looked_at: _containers.RepeatedScalarFieldContainer[int]
    meters: bool
    sentence: str
    def __init__(self, scene_id: _Optional[str] = ..., id: _Optional[str] = ..., seen_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., seen_at_source: _Optional[_Union[SeenAtSource, str]] = ..., photos: _Optional[_Iterable[_Union[ObservedPhoto, _Mapping]]] = ..., left_out: _Optional[_Iterable[str]] = ..., changes: _Optional[_Iterable[_Union[SceneChange, _Mapping]]] = ..., looked_at: _Optional[_Iterable[int]] = ..., meters: _Optional[bool] = ..., sentence: _Optional[str] = ...) -> None: ...

class ObservedPhoto(_message.Message):
    __slots__ = ("view", "camera", "differences")
    VIEW_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    DIFFERENCES_FIELD_NUMBER: _ClassVar[int]
    view: str
    camera: PosedCamera
    differences: _containers.RepeatedCompositeFieldContainer[PhotoDifference]
    def __init__(self, view: _Optional[str] = ..., camera: _Optional[_Union[PosedCamera, _Mapping]] = ..., differences: _Optional[_Iterable[_Union[PhotoDifference, _Mapping]]] = ...) -> None: ...

class ListObservationsRequest(_message.Message):
    __slots__ = ("scene_id", "version", "page_size", "page_token")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    version: str
    page_size: int
    page_token: str
    def __init__(self, scene_id: _Optional[str] = ..., version: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListObservationsResponse(_message.Message):
    __slots__ = ("observations", "next_page_token", "version")
    OBSERVATIONS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    observations: _containers.RepeatedCompositeFieldContainer[Observation]
    next_page_token: str
    version: str
    def __init__(self, observations: _Optional[_Iterable[_Union[Observation, _Mapping]]] = ..., next_page_token: _Optional[str] = ..., version: _Optional[str] = ...) -> None: ...

class GetObservationRequest(_message.Message):
    __slots__ = ("scene_id", "version", "observation_id")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    OBSERVATION_ID_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    version: str
    observation_id: str
    def __init__(self, scene_id: _Optional[str] = ..., version: _Optional[str] = ..., observation_id: _Optional[str] = ...) -> None: ...

class ListBestViewsRequest(_message.Message):
    __slots__ = ("scene_id", "object_ids", "text", "max_views", "version")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    OBJECT_IDS_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    MAX_VIEWS_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    object_ids: _containers.RepeatedScalarFieldContainer[int]
    text: str
    max_views: int
    version: str
    def __init__(self, scene_id: _Optional[str] = ..., object_ids: _Optional[_Iterable[int]] = ..., text: _Optional[str] = ..., max_views: _Optional[int] = ..., version: _Optional[str] = ...) -> None: ...

class ListBestViewsResponse(_message.Message):
    __slots__ = ("views", "version")
    VIEWS_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    views: _containers.RepeatedCompositeFieldContainer[BestView]
    version: str
    def __init__(self, views: _Optional[_Iterable[_Union[BestView, _Mapping]]] = ..., version: _Optional[str] = ...) -> None: ...

class BestView(_message.Message):
    __slots__ = ("view", "share", "cut_off", "photo", "mask")
    VIEW_FIELD_NUMBER: _ClassVar[int]
    SHARE_FIELD_NUMBER: _ClassVar[int]
    CUT_OFF_FIELD_NUMBER: _ClassVar[int]
    PHOTO_FIELD_NUMBER: _ClassVar[int]
    MASK_FIELD_NUMBER: _ClassVar[int]
    view: str
    share: float
    cut_off: bool
    photo: bool
    mask: ViewMask
    def __init__(self, view: _Optional[str] = ..., share: _Optional[float] = ..., cut_off: _Optional[bool] = ..., photo: _Optional[bool] = ..., mask: _Optional[_Union[ViewMask, _Mapping]] = ...) -> None: ...

class GetContactSheetRequest(_message.Message):
    __slots__ = ("scene_id", "version", "page_size", "page_token")
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    scene_id: str
    version: str
    page_size: int
    page_token: str
    def __init__(self, scene_id: _Optional[str] = ..., version: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ContactSheet(_message.Message):
    __slots__ = ("picture", "objects", "unseen", "meters", "next_page_token", "version", "written")
    PICTURE_FIELD_NUMBER: _ClassVar[int]
    OBJECTS_FIELD_NUMBER: _ClassVar[int]
    UNSEEN_FIELD_NUMBER: _ClassVar[int]
    METERS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    WRITTEN_FIELD_NUMBER: _ClassVar[int]
    picture: bytes
    objects: _containers.RepeatedCompositeFieldContainer[SheetObject]
    unseen: _containers.RepeatedScalarFieldContainer[int]
    meters: bool
    next_page_token: str
    version: str
    written: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, picture: _Optional[bytes] = ..., objects: _Optional[_Iterable[_Union[SheetObject, _Mapping]]] = ..., unseen: _Optional[_Iterable[int]] = ..., meters: _Optional[bool] = ..., next_page_token: _Optional[str] = ..., version: _Optional[str] = ..., written: _Optional[_Iterable[str]] = ...) -> None: ...

class SheetObject(_message.Message):
    __slots__ = ("number", "object_id", "view", "photo", "size", "surface", "neighbors", "suggestions")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    VIEW_FIELD_NUMBER: _ClassVar[int]
    PHOTO_FIELD_NUMBER: _ClassVar[int]
    SIZE_FIELD_NUMBER: _ClassVar[int]
    SURFACE_FIELD_NUMBER: _ClassVar[int]
    NEIGHBORS_FIELD_NUMBER: _ClassVar[int]
    SUGGESTIONS_FIELD_NUMBER: _ClassVar[int]
    number: int
    object_id: int
    view: str
    photo: bool
    size: Vector3
    surface: str
    neighbors: _containers.RepeatedCompositeFieldContainer[NeighborObject]
    suggestions: _containers.RepeatedCompositeFieldContainer[NameSuggestion]
    def __init__(self, number: _Optional[int] = ..., object_id: _Optional[int] = ..., view: _Optional[str] = ..., photo: _Optional[bool] = ..., size: _Optional[_Union[Vector3, _Mapping]] = ..., surface: _Optional[str] = ..., neighbors: _Optional[_Iterable[_Union[NeighborObject, _Mapping]]] = ..., suggestions: _Optional[_Iterable[_Union[NameSuggestion, _Mapping]]] = ...) -> None: ...

class NeighborObject(_message.Message):
    __slots__ = ("object_id", "name")
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    object_id: int
    name: str
    def __init__(self, object_id: _Optional[int] = ..., name: _Optional[str] = ...) -> None: ...

class CreateKeyRequest(_message.Message):
    __slots__ = ("name", "role", "lifetime_s", "scene_id")
    NAME_FIELD_NUMBER: _ClassVar[int]
    ROLE_FIELD_NUMBER: _ClassVar[int]
    LIFETIME_S_FIELD_NUMBER: _ClassVar[int]
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    name: str
    role: Role
    lifetime_s: float
    scene_id: str
    def __init__(self, name: _Optional[str] = ..., role: _Optional[_Union[Role, str]] = ..., lifetime_s: _Optional[float] = ..., scene_id: _Optional[str] = ...) -> None: ...

class NewKey(_message.Message):
    __slots__ = ("key", "secret")
    KEY_FIELD_NUMBER: _ClassVar[int]
    SECRET_FIELD_NUMBER: _ClassVar[int]
    key: AccessKey
    secret: str
    def __init__(self, key: _Optional[_Union[AccessKey, _Mapping]] = ..., secret: _Optional[str] = ...) -> None: ...

class AccessKey(_message.Message):
    __slots__ = ("id", "name", "project", "role", "state", "created_at", "expires_at", "revoked_at", "scene_id", "operation_id")
    ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    PROJECT_FIELD_NUMBER: _ClassVar[int]
    ROLE_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_FIELD_NUMBER: _ClassVar[int]
    EXPIRES_AT_FIELD_NUMBER: _ClassVar[int]
    REVOKED_AT_FIELD_NUMBER: _ClassVar[int]
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    OPERATION_ID_FIELD_NUMBER: _ClassVar[int]
    id: str
    name: str
    project: str
    role: Role
    state: KeyState
    created_at: _timestamp_pb2.Timestamp
    expires_at: _timestamp_pb2.Timestamp
    revoked_at: _timestamp_pb2.Timestamp
    scene_id: str
    operation_id: str
    def __init__(self, id: _Optional[str] = ..., name: _Optional[str] = ..., project: _Optional[str] = ..., role: _Optional[_Union[Role, str]] = ..., state: _Optional[_Union[KeyState, str]] = ..., created_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., expires_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., revoked_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., scene_id: _Optional[str] = ..., operation_id: _Optional[str] = ...) -> None: ...

class CreateUploadKeyRequest(_message.Message):
    __slots__ = ("lifetime_s",)
    LIFETIME_S_FIELD_NUMBER: _ClassVar[int]
    lifetime_s: float
    def __init__(self, lifetime_s: _Optional[float] = ...) -> None: ...

class ListKeysRequest(_message.Message):
    __slots__ = ("page_size", "page_token", "scene_id")
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    page_size: int
    page_token: str
    scene_id: str
    def __init__(self, page_size: _Optional[int] = ..., page_token: _Optional[str] = ..., scene_id: _Optional[str] = ...) -> None: ...

class ListKeysResponse(_message.Message):
    __slots__ = ("keys", "next_page_token")
    KEYS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    keys: _containers.RepeatedCompositeFieldContainer[AccessKey]
    next_page_token: str
    def __init__(self, keys: _Optional[_Iterable[_Union[AccessKey, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class RevokeKeyRequest(_message.Message):
    __slots__ = ("key_id",)
    KEY_ID_FIELD_NUMBER: _ClassVar[int]
    key_id: str
    def __init__(self, key_id: _Optional[str] = ...) -> None: ...

class EstimateJobRequest(_message.Message):
    __slots__ = ("photos", "width", "height", "preset")
    PHOTOS_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    PRESET_FIELD_NUMBER: _ClassVar[int]
    photos: int
    width: int
    height: int
    preset: str
    def __init__(self, photos: _Optional[int] = ..., width: _Optional[int] = ..., height: _Optional[int] = ..., preset: _Optional[str] = ...) -> None: ...

class JobEstimate(_message.Message):
    __slots__ = ("seconds", "stages")
    class StagesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    SECONDS_FIELD_NUMBER: _ClassVar[int]
    STAGES_FIELD_NUMBER: _ClassVar[int]
    seconds: float
    stages: _containers.ScalarMap[str, float]
    def __init__(self, seconds: _Optional[float] = ..., stages: _Optional[_Mapping[str, float]] = ...) -> None: ...

class ServerStatus(_message.Message):
    __slots__ = ("version", "project", "role", "key_expires_at", "upload_operation", "models", "backend", "training_backend", "workers", "quotas", "max_upload_bytes", "max_images", "addresses", "captioner", "health", "asks_for_keys")
    VERSION_FIELD_NUMBER: _ClassVar[int]
    PROJECT_FIELD_NUMBER: _ClassVar[int]
    ROLE_FIELD_NUMBER: _ClassVar[int]
    KEY_EXPIRES_AT_FIELD_NUMBER: _ClassVar[int]
    UPLOAD_OPERATION_FIELD_NUMBER: _ClassVar[int]
    MODELS_FIELD_NUMBER: _ClassVar[int]
    BACKEND_FIELD_NUMBER: _ClassVar[int]
    TRAINING_BACKEND_FIELD_NUMBER: _ClassVar[int]
    WORKERS_FIELD_NUMBER: _ClassVar[int]
    QUOTAS_FIELD_NUMBER: _ClassVar[int]
    MAX_UPLOAD_BYTES_FIELD_NUMBER: _ClassVar[int]
    MAX_IMAGES_FIELD_NUMBER: _ClassVar[int]
    ADDRESSES_FIELD_NUMBER: _ClassVar[int]
    CAPTIONER_FIELD_NUMBER: _ClassVar[int]
    HEALTH_FIELD_NUMBER: _ClassVar[int]
    ASKS_FOR_KEYS_FIELD_NUMBER: _ClassVar[int]
    version: str
    project: str
    role: Role
    key_expires_at: _timestamp_pb2.Timestamp
    upload_operation: str
    models: _containers.RepeatedCompositeFieldContainer[ModelStatus]
    backend: str
    training_backend: str
    workers: int
    quotas: _containers.RepeatedCompositeFieldContainer[QuotaStatus]
    max_upload_bytes: int
    max_images: int
    addresses: _containers.RepeatedScalarFieldContainer[str]
    captioner: CaptionerStatus
    health: ServerHealth
    asks_for_keys: bool
    def __init__(self, version: _Optional[str] = ..., project: _Optional[str] = ..., role: _Optional[_Union[Role, str]] = ..., key_expires_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., upload_operation: _Optional[str] = ..., models: _Optional[_Iterable[_Union[ModelStatus, _Mapping]]] = ..., backend: _Optional[str] = ..., training_backend: _Optional[str] = ..., workers: _Optional[int] = ..., quotas: _Optional[_Iterable[_Union[QuotaStatus, _Mapping]]] = ..., max_upload_bytes: _Optional[int] = ..., max_images: _Optional[int] = ..., addresses: _Optional[_Iterable[str]] = ..., captioner: _Optional[_Union[CaptionerStatus, _Mapping]] = ..., health: _Optional[_Union[ServerHealth, _Mapping]] = ..., asks_for_keys: _Optional[bool] = ...) -> None: ...

class ModelStatus(_message.Message):
    __slots__ = ("role", "name", "state", "calibrated")
    ROLE_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    CALIBRATED_FIELD_NUMBER: _ClassVar[int]
    role: str
    name: str
    state: str
    calibrated: bool
    def __init__(self, role: _Optional[str] = ..., name: _Optional[str] = ..., state: _Optional[str] = ..., calibrated: _Optional[bool] = ...) -> None: ...

class QuotaStatus(_message.Message):
    __slots__ = ("kind", "used", "limit")
    KIND_FIELD_NUMBER: _ClassVar[int]
    USED_FIELD_NUMBER: _ClassVar[int]
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    kind: str
    used: int
    limit: int
    def __init__(self, kind: _Optional[str] = ..., used: _Optional[int] = ..., limit: _Optional[int] = ...) -> None: ...

class CaptionerStatus(_message.Message):
    __slots__ = ("host", "model", "agreed")
    HOST_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    AGREED_FIELD_NUMBER: _ClassVar[int]
    host: str
    model: str
    agreed: bool
    def __init__(self, host: _Optional[str] = ..., model: _Optional[str] = ..., agreed: _Optional[bool] = ...) -> None: ...

class ServerHealth(_message.Message):
    __slots__ = ("workers", "queue", "disk")
    WORKERS_FIELD_NUMBER: _ClassVar[int]
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    DISK_FIELD_NUMBER: _ClassVar[int]
    workers: _containers.RepeatedCompositeFieldContainer[WorkerHealth]
    queue: QueueHealth
    disk: DiskHealth
    def __init__(self, workers: _Optional[_Iterable[_Union[WorkerHealth, _Mapping]]] = ..., queue: _Optional[_Union[QueueHealth, _Mapping]] = ..., disk: _Optional[_Union[DiskHealth, _Mapping]] = ...) -> None: ...

class WorkerHealth(_message.Message):
    __slots__ = ("host", "pid", "silent_s", "alive")
    HOST_FIELD_NUMBER: _ClassVar[int]
    PID_FIELD_NUMBER: _ClassVar[int]
    SILENT_S_FIELD_NUMBER: _ClassVar[int]
    ALIVE_FIELD_NUMBER: _ClassVar[int]
    host: str
    pid: int
    silent_s: float
    alive: bool
    def __init__(self, host: _Optional[str] = ..., pid: _Optional[int] = ..., silent_s: _Optional[float] = ..., alive: _Optional[bool] = ...) -> None: ...

class QueueHealth(_message.Message):
    __slots__ = ("waiting", "running", "waits_s")
    WAITING_FIELD_NUMBER: _ClassVar[int]
    RUNNING_FIELD_NUMBER: _ClassVar[int]
    WAITS_S_FIELD_NUMBER: _ClassVar[int]
    waiting: int
    running: int
    waits_s: float
    def __init__(self, waiting: _Optional[int] = ..., running: _Optional[int] = ..., waits_s: _Optional[float] = ...) -> None: ...

class DiskHealth(_message.Message):
    __slots__ = ("total_bytes", "free_bytes", "floor_bytes")
    TOTAL_BYTES_FIELD_NUMBER: _ClassVar[int]
    FREE_BYTES_FIELD_NUMBER: _ClassVar[int]
    FLOOR_BYTES_FIELD_NUMBER: _ClassVar[int]
    total_bytes: int
    free_bytes: int
    floor_bytes: int
    def __init__(self, total_bytes: _Optional[int] = ..., free_bytes: _Optional[int] = ..., floor_bytes: _Optional[int] = ...) -> None: ...

class AgreeToCaptionerRequest(_message.Message):
    __slots__ = ("host",)
    HOST_FIELD_NUMBER: _ClassVar[int]
    host: str
    def __init__(self, host: _Optional[str] = ...) -> None: ...

class ListProjectsResponse(_message.Message):
    __slots__ = ("projects",)
    PROJECTS_FIELD_NUMBER: _ClassVar[int]
    projects: _containers.RepeatedCompositeFieldContainer[Project]
    def __init__(self, projects: _Optional[_Iterable[_Union[Project, _Mapping]]] = ...) -> None: ...

class Project(_message.Message):
    __slots__ = ("name", "created_at", "scenes", "keys")
    NAME_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_FIELD_NUMBER: _ClassVar[int]
    SCENES_FIELD_NUMBER: _ClassVar[int]
    KEYS_FIELD_NUMBER: _ClassVar[int]
    name: str
    created_at: _timestamp_pb2.Timestamp
    scenes: int
    keys: int
    def __init__(self, name: _Optional[str] = ..., created_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., scenes: _Optional[int] = ..., keys: _Optional[int] = ...) -> None: ...

class CreateProjectRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class ListKnownNamesRequest(_message.Message):
    __slots__ = ("page_size", "page_token")
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    page_size: int
    page_token: str
    def __init__(self, page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListKnownNamesResponse(_message.Message):
    __slots__ = ("names", "next_page_token")
    NAMES_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    names: _containers.RepeatedCompositeFieldContainer[KnownName]
    next_page_token: str
    def __init__(self, names: _Optional[_Iterable[_Union[KnownName, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class KnownName(_message.Message):
    __slots__ = ("id", "name", "scene_id", "version", "object_id", "named_at", "picture")
    ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    OBJECT_ID_FIELD_NUMBER: _ClassVar[int]
    NAMED_AT_FIELD_NUMBER: _ClassVar[int]
    PICTURE_FIELD_NUMBER: _ClassVar[int]
    id: str
    name: str
    scene_id: str
    version: str
    object_id: int
    named_at: _timestamp_pb2.Timestamp
    picture: bytes
    def __init__(self, id: _Optional[str] = ..., name: _Optional[str] = ..., scene_id: _Optional[str] = ..., version: _Optional[str] = ..., object_id: _Optional[int] = ..., named_at: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., picture: _Optional[bytes] = ...) -> None: ...

class DeleteKnownNameRequest(_message.Message):
    __slots__ = ("name_id",)
    NAME_ID_FIELD_NUMBER: _ClassVar[int]
    name_id: str
    def __init__(self, name_id: _Optional[str] = ...) -> None: ...

class CreateSceneRequest(_message.Message):
    __slots__ = ("header", "file", "chunk")
    HEADER_FIELD_NUMBER: _ClassVar[int]
    FILE_FIELD_NUMBER: _ClassVar[int]
    CHUNK_FIELD_NUMBER: _ClassVar[int]
    header: CreateSceneHeader
    file: FileHeader
    chunk: bytes
    def __init__(self, header: _Optional[_Union[CreateSceneHeader, _Mapping]] = ..., file: _Optional[_Union[FileHeader, _Mapping]] = ..., chunk: _Optional[bytes] = ...) -> None: ...

class FileHeader(_message.Message):
    __slots__ = ("name", "size_bytes")
    NAME_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    name: str
    size_bytes: int
    def __init__(self, name: _Optional[str] = ..., size_bytes: _Optional[int] = ...) -> None: ...

class Chunk(_message.Message):
    __slots__ = ("data",)
    DATA_FIELD_NUMBER: _ClassVar[int]
    data: bytes
    def __init__(self, data: _Optional[bytes] = ...) -> None: ...

class QueryResponse(_message.Message):
    __slots__ = ("answer", "masks", "mask3d", "objects", "matches", "skipped", "skipped_count")
    ANSWER_FIELD_NUMBER: _ClassVar[int]
    MASKS_FIELD_NUMBER: _ClassVar[int]
    MASK3D_FIELD_NUMBER: _ClassVar[int]
    OBJECTS_FIELD_NUMBER: _ClassVar[int]
    MATCHES_FIELD_NUMBER: _ClassVar[int]
    SKIPPED_FIELD_NUMBER: _ClassVar[int]
    SKIPPED_COUNT_FIELD_NUMBER: _ClassVar[int]
    answer: Answer
    masks: _containers.RepeatedCompositeFieldContainer[ViewMask]
    mask3d: bytes
    objects: _containers.RepeatedCompositeFieldContainer[SceneObject]
    matches: _containers.RepeatedCompositeFieldContainer[Match]
    skipped: _containers.RepeatedCompositeFieldContainer[SkippedScene]
    skipped_count: int
    def __init__(self, answer: _Optional[_Union[Answer, _Mapping]] = ..., masks: _Optional[_Iterable[_Union[ViewMask, _Mapping]]] = ..., mask3d: _Optional[bytes] = ..., objects: _Optional[_Iterable[_Union[SceneObject, _Mapping]]] = ..., matches: _Optional[_Iterable[_Union[Match, _Mapping]]] = ..., skipped: _Optional[_Iterable[_Union[SkippedScene, _Mapping]]] = ..., skipped_count: _Optional[int] = ...) -> None: ...

class StreamQueryRequest(_message.Message):
    __slots__ = ("question", "pose")
    QUESTION_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    question: Subscription
    pose: StreamPose
    def __init__(self, question: _Optional[_Union[Subscription, _Mapping]] = ..., pose: _Optional[_Union[StreamPose, _Mapping]] = ...) -> None: ...

class Subscription(_message.Message):
    __slots__ = ("query", "heartbeat_s")
    QUERY_FIELD_NUMBER: _ClassVar[int]
    HEARTBEAT_S_FIELD_NUMBER: _ClassVar[int]
    query: QueryRequest
    heartbeat_s: float
    def __init__(self, query: _Optional[_Union[QueryRequest, _Mapping]] = ..., heartbeat_s: _Optional[float] = ...) -> None: ...

class StreamPose(_message.Message):
    __slots__ = ("sequence", "camera", "stamp")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    CAMERA_FIELD_NUMBER: _ClassVar[int]
    STAMP_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    camera: PosedCamera
    stamp: _timestamp_pb2.Timestamp
    def __init__(self, sequence: _Optional[int] = ..., camera: _Optional[_Union[PosedCamera, _Mapping]] = ..., stamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ...) -> None: ...

class StreamQueryResponse(_message.Message):
    __slots__ = ("sequence", "question", "stamp", "accepted", "response", "done", "dropped", "heartbeat")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    QUESTION_FIELD_NUMBER: _ClassVar[int]
    STAMP_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    RESPONSE_FIELD_NUMBER: _ClassVar[int]
    DONE_FIELD_NUMBER: _ClassVar[int]
    DROPPED_FIELD_NUMBER: _ClassVar[int]
    HEARTBEAT_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    question: int
    stamp: _timestamp_pb2.Timestamp
    accepted: Accepted
    response: QueryResponse
    done: PoseDone
    dropped: DroppedPoses
    heartbeat: Heartbeat
    def __init__(self, sequence: _Optional[int] = ..., question: _Optional[int] = ..., stamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., accepted: _Optional[_Union[Accepted, _Mapping]] = ..., response: _Optional[_Union[QueryResponse, _Mapping]] = ..., done: _Optional[_Union[PoseDone, _Mapping]] = ..., dropped: _Optional[_Union[DroppedPoses, _Mapping]] = ..., heartbeat: _Optional[_Union[Heartbeat, _Mapping]] = ...) -> None: ...

class Accepted(_message.Message):
    __slots__ = ("version",)
    VERSION_FIELD_NUMBER: _ClassVar[int]
    version: str
    def __init__(self, version: _Optional[str] = ...) -> None: ...

class PoseDone(_message.Message):
    __slots__ = ("seconds",)
    SECONDS_FIELD_NUMBER: _ClassVar[int]
    seconds: float
    def __init__(self, seconds: _Optional[float] = ...) -> None: ...

class DroppedPoses(_message.Message):
    __slots__ = ("first", "last", "count")
    FIRST_FIELD_NUMBER: _ClassVar[int]
    LAST_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    first: int
    last: int
    count: int
    def __init__(self, first: _Optional[int] = ..., last: _Optional[int] = ..., count: _Optional[int] = ...) -> None: ...

class Heartbeat(_message.Message):
    __slots__ = ("time",)
    TIME_FIELD_NUMBER: _ClassVar[int]
    time: _timestamp_pb2.Timestamp
    def __init__(self, time: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ...) -> None: ...
