"""The table of calls: each is declared here once.

Derived from it are who may call what (`api.access.policy`), the service in the .proto, and, with
`api.handlers`, the RPCs and REST routes that do no more than ask and answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timezone
from types import NoneType
from typing import Any

from fastsplat_contract.call import APART, Call, Rule
from fastsplat_contract.jobs.job_watching import PlacedCameras, Preview
from fastsplat_contract.jobs.name_suggestions import AgreeIn, CaptionerStatus
from fastsplat_contract.jobs.operations import JobEstimate, Operation, OperationList
from fastsplat_contract.messages import requests
from fastsplat_contract.messages.contact_sheets import ContactSheet
from fastsplat_contract.messages.detections import DetectionList
from fastsplat_contract.messages.edit_previews import EditPreview, PreviewEditRequest
from fastsplat_contract.messages.exports import ExportRequest
from fastsplat_contract.messages.goals import Goal
from fastsplat_contract.messages.known_names import KnownNameList
from fastsplat_contract.messages.measurements import Measurement, MeasureRequest
from fastsplat_contract.messages.objects import ObjectList, PickedObject, PickRequest
from fastsplat_contract.messages.projects import CreateProjectRequest, GetJobLogRequest, JobLog, Project, ProjectList
from fastsplat_contract.messages.queries import QueryOut, QueryRequest
from fastsplat_contract.messages.scenes import LabelList, Scene, SceneList, SceneVersion, VersionList
from fastsplat_contract.photos.localization import Localization, LocalizeRequest
from fastsplat_contract.photos.next_photos import NextPhotoList
from fastsplat_contract.photos.observations import (
    GetObservationRequest,
    ListObservationsRequest,
    Observation,
    ObservationList,
    ObserveRequest,
)
from fastsplat_contract.photos.photo_verdicts import PhotoVerdictList
from fastsplat_contract.photos.pictures import PictureRequest
from fastsplat_contract.photos.scene_photos import BestViewList, PhotoList
from fastsplat_contract.server.keys import AccessKey, KeyIn, KeyList, NewKey, UploadKeyIn
from fastsplat_contract.server.server_status import ServerStatus

READ = Rule("reader")
SHOW = Rule("reader", shared=True)
FETCH = Rule("reader", long_lived=True, shared=True)
EDIT = Rule("editor")
ADMIN = Rule("admin")
OPERATE = Rule("operator")
UPLOAD = Rule("editor", long_lived=True, upload=True, also=("uploader",))
FOLLOW = Rule("reader", also=("uploader",))
FOLLOW_LONG = Rule("reader", long_lived=True, also=("uploader",))

_SCENE, _JOB = "/v1/scenes/{scene_id}", "/v1/operations/{operation_id}"

# fmt: off
CREATE_SCENE = Call(
    "CreateScene", "scenes", requests.CreateSceneHeader, Operation, UPLOAD, "POST /v1/scenes",
    "Upload a capture and queue its training. One header, then for each file its FileHeader followed by its chunks. "
    "The answer is durable: once it is sent, the job survives a crash. Cancelling the call leaves nothing behind.",
    pieces_in="CreateSceneRequest")
OPEN_SAMPLE = Call(
    "OpenSample", "scenes", requests.OpenSampleRequest, Scene, EDIT, "POST /v1/scenes:openSample",
    "The project's copy of the sample scene that the server brings; it is made where there is none.")
GET_SCENE = Call(
    "GetScene", "scenes", requests.GetSceneRequest, Scene, SHOW, f"GET {_SCENE}",
    "One scene with its dictionary, cameras and quality.")
LIST_SCENES = Call(
    "ListScenes", "scenes", requests.ListScenesRequest, SceneList, SHOW, "GET /v1/scenes",
    "Scenes in pages, newest first.")
UPDATE_SCENE = Call(
    "UpdateScene", "scenes", requests.UpdateSceneRequest, Scene, EDIT, f"PATCH {_SCENE}", "Rename a scene.")
DELETE_SCENE = Call(
    "DeleteScene", "scenes", requests.DeleteSceneRequest, NoneType, ADMIN, f"DELETE {_SCENE}",
    "Forget a scene and all its files; its job stops.", status=204, repeatable=False)
LIST_PHOTO_VERDICTS = Call(
    "ListPhotoVerdicts", "scenes", requests.ListPhotoVerdictsRequest, PhotoVerdictList, READ,
    f"GET {_SCENE}/photo-verdicts",
    "What became of each photo of a scene's capture, in pages, by name; once its capture stage is done.")
LIST_LABELS = Call(
    "ListLabels", "scenes", requests.ListLabelsRequest, LabelList, SHOW, f"GET {_SCENE}/labels",
    "The dictionary in pages, by label id.")
LIST_OBJECTS = Call(
    "ListObjects", "scenes", requests.ListObjectsRequest, ObjectList, SHOW, f"GET {_SCENE}/objects",
    "Every object of a scene, with or without a name, in pages, by id.")
PICK_OBJECT = Call(
    "PickObject", "queries", PickRequest, PickedObject, SHOW, f"POST {_SCENE}:pick",
    "The object at a pixel or in a box of a view, or at a point of the scene, with its mask.")
MEASURE_SCENE = Call(
    "MeasureScene", "queries", MeasureRequest, Measurement, SHOW, f"POST {_SCENE}:measure",
    "How far two places are from each other, how large an object is, or where a place is.")

EDIT_SCENE = Call(
    "EditScene", "scenes", requests.EditSceneRequest, SceneVersion, EDIT, f"POST {_SCENE}:edit",
    "Make a new version of a scene: the edits in order, all or none; it is current on return.")
PREVIEW_EDIT = Call(
    "PreviewEdit", "scenes", PreviewEditRequest, EditPreview, READ, f"POST {_SCENE}:previewEdit",
    "Which Gaussians edits would remove from a scene; nothing is changed.")
SUGGEST_NAMES = Call(
    "SuggestNames", "scenes", requests.SuggestNamesRequest, SceneVersion, EDIT._replace(also=("suggester",)),
    f"POST {_SCENE}/name-suggestions",
    "Suggest names for objects: they can be asked for and are shown with who says so, and nothing bears them until\n"
    "somebody gives them by EditScene. All or none; they make a version, which is current on return.")
ASK_CAPTIONER = Call(
    "AskCaptioner", "scenes", requests.AskCaptionerRequest, Operation, EDIT, f"POST {_SCENE}:askCaptioner",
    "Ask the server's captioner what the objects of a scene without a name are: an operation that suggests what it "
    "says.\nRefused where the server has none, and before the project agreed to its host.",
    body_optional=True, status=202)
UNDO_EDIT = Call(
    "UndoEdit", "scenes", requests.UndoEditRequest, SceneVersion, EDIT, f"POST {_SCENE}:undo",
    "Go back to the version before the current one.",
    body_optional=True, repeatable=False)
REDO_EDIT = Call(
    "RedoEdit", "scenes", requests.RedoEditRequest, SceneVersion, EDIT, f"POST {_SCENE}:redo",
    "Go forward to the version that was undone: of several made of the current one, the one current last.",
    body_optional=True, repeatable=False)
RESTORE_VERSION = Call(
    "RestoreVersion", "scenes", requests.RestoreVersionRequest, SceneVersion, EDIT, f"POST {_SCENE}:restore",
    "Make any version of a scene the current one; all others stay.")
LIST_VERSIONS = Call(
    "ListVersions", "scenes", requests.ListVersionsRequest, VersionList, SHOW, f"GET {_SCENE}/versions",
    "Every version of a scene, oldest first.")
LOOK_AGAIN = Call(
    "LookAgain", "scenes", requests.LookAgainRequest, Operation, EDIT, f"POST {_SCENE}:lookAgain",
    "Search a scene for more names with the server's open-set detector: an operation that makes a version.",
    status=202)

GET_OPERATION = Call(
    "GetOperation", "operations", requests.GetOperationRequest, Operation, FOLLOW, f"GET {_JOB}",
    "Where a job stands, stage by stage.")
LIST_OPERATIONS = Call(
    "ListOperations", "operations", requests.ListOperationsRequest, OperationList, READ, "GET /v1/operations",
    "Operations in pages, newest first.")
CANCEL_OPERATION = Call(
    "CancelOperation", "operations", requests.CancelOperationRequest, Operation, EDIT, f"POST {_JOB}:cancel",
    "Ask a job to stop; one that is over stays as it is.")
RETRY_OPERATION = Call(
    "RetryOperation", "operations", requests.RetryOperationRequest, Operation, EDIT, f"POST {_JOB}:retry",
    "Queue a failed or cancelled job again, with the upload that it had, or with less of it; one in another state\n"
    "stays as it is.",
    body_optional=True)
FINISH_OPERATION = Call(
    "FinishOperation", "operations", requests.FinishOperationRequest, Operation, EDIT, f"POST {_JOB}:finish",
    "Ask a job to end its training early, and to make the scene of what is there; asked again nothing changes.")
GET_PREVIEW = Call(
    "GetPreview", "operations", requests.GetPreviewRequest, Preview, READ, f"GET {_JOB}/preview",
    "The newest picture of a scene that is being trained, with its step and figures.",
    also=(f"GET {_JOB}/preview.jpg",))
GET_PLACED_CAMERAS = Call(
    "GetPlacedCameras", "operations", requests.GetPlacedCamerasRequest, PlacedCameras, READ, f"GET {_JOB}/cameras",
    "The cameras that a job has placed so far, and some of its points.")
GET_JOB_LOG = Call(
    "GetJobLog", "operations", GetJobLogRequest, JobLog, ADMIN, f"GET {_JOB}/log",
    "The end of what the trainers of a job wrote; where a server can read the logs of its workers.")
WAIT_OPERATION = Call(
    "WaitOperation", "operations", requests.WaitOperationRequest, Operation, FOLLOW_LONG, f"GET {_JOB}:wait",
    "The operation as soon as it is done, or as it stands when the time is up.")
WATCH_OPERATION = Call(
    "WatchOperation", "operations", requests.WatchOperationRequest, Operation, FOLLOW_LONG, f"GET {_JOB}/events",
    "The operation now and on every change, until it is done.", pieces_out="Operation")

QUERY = Call(
    "Query", "queries", QueryRequest, QueryOut, SHOW, f"POST {_SCENE}:query",
    "Ranked labels, and masks and objects if asked for. Each text is answered by one or several messages that follow "
    "each other; see QueryResponse.",
    also=("GET /query", f"GET {_SCENE}/mask3d.bin"), pieces_out="QueryResponse")
STREAM_QUERY = Call(
    "StreamQuery", "queries", QueryRequest, QueryOut, FETCH, "",
    "A subscription and pose after pose; see StreamQueryRequest.",
    pieces_in="StreamQueryRequest", pieces_out="StreamQueryResponse")
RENDER_VIEW = Call(
    "RenderView", "queries", PictureRequest, bytes, SHOW, f"POST {_SCENE}:render", "One picture, in chunks.",
    also=(f"GET {_SCENE}/{{kind}}.png", f"GET {_SCENE}/{{kind}}.npy"), pieces_out="Chunk")
EXPORT_SCENE = Call(
    "ExportScene", "queries", ExportRequest, bytes, FETCH, f"GET {_SCENE}/scene.{{format}}",
    "The scene as a file for other programs, in chunks; see ExportFormat.",
    also=(f"GET {_SCENE}/scene.ply",), pieces_out="Chunk")

LIST_PHOTOS = Call(
    "ListPhotos", "queries", requests.ListPhotosRequest, PhotoList, SHOW, f"GET {_SCENE}/photos",
    "The photos that are stored with a scene, in pages, in the order of its cameras.")
DOWNLOAD_PHOTO = Call(
    "DownloadPhoto", "queries", requests.DownloadPhotoRequest, bytes, SHOW, f"GET {_SCENE}/photo.jpg",
    "A photo as JPEG, in chunks: undistorted, so that it fits its camera with the intrinsics scaled to its size.",
    pieces_out="Chunk")
LIST_NEXT_PHOTOS = Call(
    "ListNextPhotos", "queries", requests.ListNextPhotosRequest, NextPhotoList, SHOW, f"GET {_SCENE}/next-photos",
    "Where to stand for the next photos of a scene: at most three places, the most useful first.")
GET_GOAL = Call(
    "GetGoal", "queries", requests.GetGoalRequest, Goal, SHOW, f"GET {_SCENE}/goal",
    "The free place nearest to an object from which a robot sees it; of scenes in meters with z up.")
LIST_DETECTIONS = Call(
    "ListDetections", "queries", requests.ListDetectionsRequest, DetectionList, SHOW, f"GET {_SCENE}/detections",
    "The objects of a scene in pages, by id: poses with covariances, names with probabilities, what carries them,\n"
    "and by which views they are known.")
LOCALIZE = Call(
    "Localize", "queries", LocalizeRequest, Localization, SHOW, f"POST {_SCENE}:localize",
    "Where photos were taken in a scene, what is seen from there, and what has changed. All photos of a request are in "
    "one message; REST takes larger ones.")
OBSERVE_SCENE = Call(
    "ObserveScene", "queries", ObserveRequest, Observation, EDIT, f"POST {_SCENE}/observations",
    "Keep photos of another day, and what they show to be gone, moved, new or changed, with a scene: a new version, "
    "current on return. All photos of a request are in one message; REST takes larger ones.", repeatable=False)
LIST_OBSERVATIONS = Call(
    "ListObservations", "queries", ListObservationsRequest, ObservationList, SHOW, f"GET {_SCENE}/observations",
    "What photos of other days said of a scene, in pages, the newest photos first.")
GET_OBSERVATION = Call(
    "GetObservation", "queries", GetObservationRequest, Observation, SHOW,
    f"GET {_SCENE}/observations/{{observation_id}}",
    "What photos of another day said of a scene.")
LIST_BEST_VIEWS = Call(
    "ListBestViews", "queries", requests.ListBestViewsRequest, BestViewList, SHOW, f"GET {_SCENE}/views",
    "Which of the scene's cameras show some objects, or the answer to a text, best; and where in their pictures.")
GET_CONTACT_SHEET = Call(
    "GetContactSheet", "queries", requests.GetContactSheetRequest, ContactSheet, SHOW._replace(also=("suggester",)),
    f"GET {_SCENE}/objects/sheet",
    "Objects without a name in one picture, 20 at most, each from the photo that shows it best, in pages, by id.")

CREATE_KEY = Call(
    "CreateKey", "keys", KeyIn, NewKey, ADMIN, "POST /v1/keys",
    "Make a key of the project, of the caller's role at most; its secret is told this once.",
    status=201, repeatable=False)
CREATE_UPLOAD_KEY = Call(
    "CreateUploadKey", "keys", UploadKeyIn, NewKey, EDIT, "POST /v1/upload-keys",
    "Make a key with which somebody else, e.g. one's phone, may post one scene; its secret is told this once.",
    status=201, repeatable=False)
LIST_KEYS = Call(
    "ListKeys", "keys", requests.ListKeysRequest, KeyList, ADMIN, "GET /v1/keys",
    "Keys of the project in pages, newest first, of the caller's role at most; never their secrets.")
REVOKE_KEY = Call(
    "RevokeKey", "keys", requests.RevokeKeyRequest, AccessKey, ADMIN, "POST /v1/keys/{key_id}:revoke",
    "Take a key back for ever; what it has under way ends within two seconds.")

ESTIMATE_JOB = Call(
    "EstimateJob", "operations", requests.EstimateJobRequest, JobEstimate, FOLLOW, "GET /v1/estimate",
    "How long photos would take to become a scene on this server, before they are sent. Waiting for a worker is not in "
    "it.")
GET_SERVER_STATUS = Call(
    "GetServerStatus", "server", NoneType, ServerStatus, READ._replace(also=APART), "GET /v1/server/status",
    "What the server can do, and how much room the project has left, as the caller may know it.")

AGREE_TO_CAPTIONER = Call(
    "AgreeToCaptioner", "server", AgreeIn, CaptionerStatus, ADMIN, "POST /v1/captioner:agree",
    "Agree, once for the project, that pictures of its objects without a name go to the host of the server's "
    "captioner\nwhen somebody asks it; or take that back.")

LIST_PROJECTS = Call(
    "ListProjects", "server", NoneType, ProjectList, OPERATE, "GET /v1/projects",
    "Every project of the server, by name.")
CREATE_PROJECT = Call(
    "CreateProject", "server", CreateProjectRequest, Project, OPERATE, "POST /v1/projects",
    "Make a project: its keys see its scenes only, and nobody else's keys see them.", repeatable=False)

LIST_KNOWN_NAMES = Call(
    "ListKnownNames", "known names", requests.ListKnownNamesRequest, KnownNameList, READ, "GET /v1/known-names",
    "What people named in the scenes of the project and is suggested in others, in pages, newest first.")
DELETE_KNOWN_NAME = Call(
    "DeleteKnownName", "known names", requests.DeleteKnownNameRequest, NoneType, ADMIN,
    "DELETE /v1/known-names/{name_id}",
    "Suggest a name, or every name of the project, no more, and remove what it looks like; scenes keep their names.",
    status=204, repeatable=False)
# fmt: on

CALLS: tuple[Call[Any, Any], ...] = tuple(value for value in list(globals().values()) if isinstance(value, Call))
"""All calls, in the order of this file."""

DEPRECATED_SINCE = datetime(2026, 11, 24, tzinfo=timezone.utc)
"""When the calls that go with the next release were replaced."""
DEPRECATED: Mapping[str, str] = {route: call.deprecated for call in CALLS if call.deprecated for route in call.routes}
"""What replaces them, by their routes of REST."""
