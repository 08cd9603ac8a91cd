"""The JSON that goes in and out. Field descriptions end up at /docs, with units and frames."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from fastsplat.service.calls.types import EditAction, Mask3dEncoding, MaskEncoding, Output, PictureFormat, PictureKind

PICTURES = (
    "rgb: the view; overlay: the answer's mask over it; relevancy: in turbo colours; mask: 0 and 255; label_map: "
    "16-bit label ids, 0 undetected; depth: 16-bit camera z / depth_scale, 0 nothing, 65535 so far or farther; "
    "depth_picture: depth in turbo colours"
)
FORMATS = "png, or npy: numpy's file of a label_map (uint16) or of depth (float32, scene units)"
DEPTH_SCALE = "scene units that one step of a 16-bit depth PNG means; 0: 0.001"
MASK3D = (
    "bits: one bit per Gaussian in row order, most significant bit first; runs: little-endian uint32 lengths of the "
    "alternating runs in row order, outside first; indices: little-endian uint32 row numbers inside, ascending; ply: "
    "the Gaussians themselves, for one text"
)


class _In(BaseModel):
    """Requests: no unknown fields, no silent conversion, no NaN."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _Out(BaseModel):
    """Answers: made of the service's values by the names of their fields."""

    model_config = ConfigDict(from_attributes=True)


class Vector3(_In):
    """Scene units (metres when the scene's scale is METRIC)."""

    x: float
    y: float
    z: float


class Quaternion(_In):
    """A rotation of unit length; mind the order x y z w."""

    x: float
    y: float
    z: float
    w: float


class Intrinsics(_In):
    """A pinhole: (x, y, z) of the camera frame lands at (fx·x/z + cx, fy·y/z + cy); pixel centres at +0.5."""

    width: int = Field(ge=1, description="pixels")
    height: int = Field(ge=1, description="pixels")
    fx: float = Field(gt=0, description="pixels")
    fy: float = Field(gt=0, description="pixels")
    cx: float = Field(description="pixels from the left edge; width / 2 is the middle")
    cy: float = Field(description="pixels from the top edge; height / 2 is the middle")


class PosedCamera(_In):
    """A camera and where it stands."""

    intrinsics: Intrinsics
    position: Vector3 = Field(description="the camera's centre in the world frame")
    orientation: Quaternion = Field(description="rotates camera axes into world axes (world_from_camera)")
    convention: Literal["OPENCV", "OPENGL"] = Field(
        "OPENCV",
        description="camera axes of `orientation`. OPENCV: x right, y down, z forward. OPENGL (nerfstudio, Blender): "
        "x right, y up, z backward. Answers always use OPENCV.",
    )
    frame_id: str = Field("world", description='the frame of position and orientation; only "world" is known')
    name: str = Field("", description="in answers, the image's name in the capture; ignored in requests")


class QueryIn(_In):
    """Questions to one scene."""

    texts: list[str] = Field(description="at least one")
    cameras: list[PosedCamera] = Field([], description="free viewpoints for 2D masks")
    views: list[str] = Field([], description="names of the scene's own cameras for 2D masks")
    outputs: list[Output] = Field([], description="what to compute beside the ranking; mask2d needs cameras or views")
    version: str = Field("", description="of the scene; empty: the current one")
    negatives: list[str] = Field([], description="canonical negatives of the relevancy; empty: the server's")
    templates: list[str] = Field([], description="sentences with one {} that texts are put into; empty: the server's")
    coverage: float | None = Field(None, description="of the label set, above 0 and below 1; null: the server's")
    max_matches: int = Field(0, ge=-1, lt=2**31, description="best entries to return; 0: the server's default, -1: all")
    mask2d_encoding: MaskEncoding = Field("rle", description="COCO run lengths, or 8-bit grey PNG with 255 inside")
    mask3d_encoding: Mask3dEncoding = Field("bits", description=MASK3D)


class RenderIn(_In):
    """One picture from a free viewpoint, or from one of the scene's own cameras."""

    kind: PictureKind = Field(description=PICTURES)
    text: str | None = Field(None, description="the question; overlay, relevancy and mask need one")
    camera: PosedCamera | None = None
    view: str | None = Field(None, description="name of one of the scene's own cameras, instead of `camera`")
    version: str = Field("", description="of the scene; empty: the current one")
    format: PictureFormat = Field("png", description=FORMATS)
    depth_scale: float = Field(0.0, ge=0, description=DEPTH_SCALE)


class Pose(_In):
    """Where something stands, or how it is moved."""

    position: Vector3 = Field(description="world frame")
    orientation: Quaternion


class Colour(_In):
    """RGB, each 0 to 1."""

    r: float = Field(ge=0, le=1)
    g: float = Field(ge=0, le=1)
    b: float = Field(ge=0, le=1)


class Edit(_In):
    """What to do to everything of a label, or to one object."""

    action: EditAction
    label: str | None = None
    object_id: str | None = Field(None, description="instead of `label`")
    colour: Colour | None = Field(None, description="for recolour")
    transform: Pose | None = Field(
        None, description="for move and duplicate: the rigid motion x' = R x + t in the world frame"
    )


class EditIn(_In):
    """A new version of a scene."""

    edits: list[Edit] = Field(description="at least one, applied in order")
    request_id: str = Field("", description="same id: the version that it made is returned again (AIP-155)")


class UndoIn(_In):
    """Back to the version before the current one."""

    version: str = Field("", description="undo only if this is the current version; makes a retry safe")


class SceneVersion(_Out):
    """One state of a scene; never changes."""

    scene_id: str
    version: str
    parent: str = Field(description="the version it was made of; empty for the trained one")
    created_at: datetime
    gaussians: int
    current: bool = Field(description="whether questions that name no version go here")
    edits: list[Edit] = Field(description="what made it of its parent")


class VersionList(_Out):
    """Every version of a scene, oldest first."""

    versions: list[SceneVersion]


class Box(_Out):
    """An oriented box, as in vision_msgs/BoundingBox3D."""

    center: Pose = Field(description="of the box's middle; orientation rotates box axes into world axes")
    size: Vector3 = Field(description="whole edge lengths along the box's axes, scene units")


class SceneObject(_Out):
    """One thing, as in vision_msgs/Detection3D: connected Gaussians of one label."""

    id: str = Field(description="stable within a version of a scene")
    label_id: int
    label: str
    score: float = Field(description="how sure its Gaussians are of the label, 0..1")
    centroid: Vector3 = Field(description="world frame, scene units")
    box: Box
    gaussian_count: int
    metres: bool = Field(description="whether lengths are metres")
    best_views: list[str] = Field(description="the scene's cameras that see it best, best first")


class ObjectList(_Out):
    """One page of a scene's objects; labels by id, within a label the largest first."""

    objects: list[SceneObject]
    next_page_token: str = Field(description="empty on the last page")
    version: str = Field(description="which version was read")


class StageProgress(_Out):
    """One stage of a job."""

    stage: str = Field(description="capture, perception, training or export")
    fraction: float = Field(description="0..1 of this stage")
    message: str
    seconds: float = Field(description="spent in this stage")
    metrics: dict[str, float]


class OperationError(_Out):
    """Why a job failed."""

    kind: str = Field(description="name of a google.rpc.Code")
    reason: str = Field(description="stable across releases")
    message: str
    stage: str = Field(description="the stage that failed")
    details: dict[str, str] = Field(description="any of field, limit, hint")


class Operation(_Out):
    """One training job (AIP-151), durable from the moment it is returned."""

    id: str
    scene_id: str
    state: Literal["QUEUED", "RUNNING", "SUCCEEDED", "FAILED", "CANCELLED"]
    done: bool = Field(description="whether the state is final")
    created_at: datetime
    updated_at: datetime
    stages: list[StageProgress] = Field(description="those begun so far, in order")
    error: OperationError | None


class OperationList(_Out):
    """One page of operations (AIP-158), newest first."""

    operations: list[Operation]
    next_page_token: str = Field(description="empty on the last page")


class DictionaryEntry(_Out):
    """One kind of thing in a scene."""

    label_id: int = Field(description="from 1; 0 means undetected")
    label: str
    aliases: list[str] = Field(description="other names merged into this entry")
    pixels: int = Field(description="over all label maps")
    views: int = Field(description="label maps it occurs in")
    gaussian_count: int = Field(description="Gaussians whose most probable class it is")


class SceneSummary(_Out):
    """A scene in a list."""

    id: str
    name: str
    state: Literal["TRAINING", "READY", "FAILED"]
    operation_id: str = Field(description="the operation that makes it")
    created_at: datetime
    gaussians: int = Field(description="G, the length of every 3D mask; 0 until ready")
    scale: Literal["METRIC", "ARBITRARY"] = Field(description="METRIC: scene units are metres")
    version: str = Field(description="the current version; empty until ready")
    label_count: int = Field(description="length of the whole dictionary")


class Scene(SceneSummary):
    """A scene; dictionary, cameras and quality are empty until it is ready."""

    camera_count: int = Field(description="number of the scene's own cameras")
    dictionary: list[DictionaryEntry] = Field(description="the first 5,000; /labels has all")
    cameras: list[PosedCamera] = Field(description="the scene's own views, the first 5,000; /cameras has all")
    quality: dict[str, Any] = Field(description="measured figures: psnr, ssim, images, registered, ...")


class SceneList(_Out):
    """One page of scenes (AIP-158), newest first."""

    scenes: list[SceneSummary]
    next_page_token: str = Field(description="empty on the last page")


class LabelList(_Out):
    """One page of a scene's dictionary, by label id."""

    labels: list[DictionaryEntry]
    next_page_token: str = Field(description="empty on the last page")


class Match(_Out):
    """One dictionary entry held against one question."""

    label_id: int
    label: str
    relevancy: float = Field(description="0..1")
    similarity: float = Field(description="cosine, -1..1")
    nearest_negative: str = Field(description="the canonical negative that set the relevancy")
    gaussian_count: int
    relevant: bool = Field(description="passes the encoder's threshold, or was asked for by name")
    probability: float | None = Field(
        description="calibrated, 0..1, that this entry is wanted; null without calibration"
    )


class Segmentation(_Out):
    """COCO run-length encoding: column-major, background first, ascii counts."""

    size: tuple[int, int] = Field(description="height, width in pixels")
    counts: str


class ViewMask(_Out):
    """A 2D mask of one answer in one camera."""

    view: str = Field(description="the scene's camera, or empty for a free viewpoint")
    camera_index: int = Field(description="which of the request's cameras; meaningless when `view` is set")
    segmentation: Segmentation | None = Field(description="null if PNG was asked for")
    png: str | None = Field(description="base64 of an 8-bit grey PNG, 255 inside, 0 outside; null unless asked for")
    area: int = Field(description="pixels inside")


class Answer(_Out):
    """The answer to one text of one scene."""

    scene_id: str
    text: str = Field(description="as asked")
    verdict: Literal["exact", "related", "absent"] = Field(
        description="exact: the thing asked for is here; related: something close is, and its label says what; "
        "absent: nothing relevant is here"
    )
    explanation: str = Field(description="one sentence for people")
    probability: float | None = Field(
        description="calibrated, 0..1, that the verdict is right; null without calibration"
    )
    label_set: list[int] = Field(
        description="label ids that together answer with probability `coverage` at least; 0 among them: perhaps "
        "nothing here answers"
    )
    coverage: float | None = Field(description="0..1; null without calibration: nothing is promised")
    decided_by: Literal["name", "score"] = Field(
        description="name: the dictionary knows the name; score: the verdict comes from `threshold`"
    )
    threshold: float | None = Field(
        description="the score that the leading entry was held against; null if a name decided"
    )
    version: str = Field(description="of the scene")
    gaussians: int = Field(description="G, the length of the 3D mask")
    match_count: int = Field(description="entries in the whole dictionary")
    matches: list[Match] = Field(description="entries of the dictionary, best first, up to `max_matches`")
    masks: list[ViewMask] = Field(description="cameras first, then views, each in the order asked")
    mask3d: str | None = Field(description="base64 in the encoding asked for; null unless asked for")
    objects: list[SceneObject] | None = Field(
        description="those that answer, by label in the order of the matches; null unless asked for"
    )


class QueryOut(_Out):
    """One answer a text; over all scenes, one a scene and text."""

    answers: list[Answer]
