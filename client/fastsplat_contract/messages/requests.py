"""Requests in full: what a call is about, which page, and, where REST has a body, what stands in that.

Each is a message of gRPC. Over REST what is named in the path stands there, and the rest in the query or the body.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from fastsplat_contract.codec.wire import Many, Request
from fastsplat_contract.jobs.look_again import LookAgainIn
from fastsplat_contract.jobs.name_suggestions import AskCaptionerIn, SuggestIn
from fastsplat_contract.jobs.operations import OperationState, PresetName, RetryIn, SceneOptions
from fastsplat_contract.messages.scenes import EditIn, OfScene, RedoIn, RestoreIn, SceneUpdate, UndoIn, Version

MAX_VIEWS = 16
_FROM_0 = {"minimum": 0}


@dataclass(frozen=True)
class OfOperation:
    """What a request about a job says."""

    operation_id: Annotated[str, Field(description="which operation")]


@dataclass(frozen=True)
class OfKey:
    """What a request about a key says."""

    key_id: Annotated[str, Field(description="which key")]


@dataclass(frozen=True)
class InPages:
    """What a request for a list says (AIP-158)."""

    page_size: Annotated[
        int,
        Field(
            description="0: the server's default; more than the server's maximum counts as the maximum",
            json_schema_extra=_FROM_0,
        ),
    ] = 0
    page_token: Annotated[
        str, Field(description="empty: the first page; otherwise next_page_token of the page before")
    ] = ""


@dataclass(frozen=True)
class OfVersion(OfScene):
    """What a request about a version of a scene says."""

    version: Version = ""


@dataclass(frozen=True)
class CreateSceneHeader(SceneOptions):
    """What a user may choose when posting a scene."""

    name: Annotated[str, Field(description="for people; need not be unique")] = ""
    request_id: Annotated[
        str, Field(description="same id, same request: the first operation is returned again (AIP-155); may be empty")
    ] = ""


@dataclass(frozen=True)
class OpenSampleRequest(Request):
    """The sample scene."""


@dataclass(frozen=True)
class GetSceneRequest(Request, OfScene):
    """Which scene to show."""


@dataclass(frozen=True)
class ListScenesRequest(Request, InPages):
    """Which page of scenes."""


@dataclass(frozen=True)
class UpdateSceneRequest(SceneUpdate, OfScene):
    """What people change about a scene itself."""


@dataclass(frozen=True)
class DeleteSceneRequest(Request, OfScene):
    """Which scene to forget."""


@dataclass(frozen=True)
class ListPhotoVerdictsRequest(Request, InPages, OfScene):
    """Which page of a capture's photos."""


@dataclass(frozen=True)
class ListLabelsRequest(Request, InPages, OfScene):
    """Which page of a scene's dictionary."""


@dataclass(frozen=True)
class ListObjectsRequest(Request, InPages, OfVersion):
    """Which page of a scene's objects."""

    parts: Annotated[bool, Field(description="whether each object is followed by its parts")] = False


@dataclass(frozen=True)
class EditSceneRequest(EditIn, OfScene):
    """A new version of a scene."""


@dataclass(frozen=True)
class SuggestNamesRequest(SuggestIn, OfScene):
    """Names that somebody suggests for objects of one scene."""


@dataclass(frozen=True)
class AskCaptionerRequest(AskCaptionerIn, OfScene):
    """The server's captioner shall say what the objects of which scene are."""


@dataclass(frozen=True)
class UndoEditRequest(UndoIn, OfScene):
    """Back to the version before the current one."""


@dataclass(frozen=True)
class RedoEditRequest(RedoIn, OfScene):
    """Forward to the version that was undone: of those made of the current one, the one that was current last."""


@dataclass(frozen=True)
class RestoreVersionRequest(RestoreIn, OfScene):
    """Make any version of a scene the current one; all others stay."""


@dataclass(frozen=True)
class ListVersionsRequest(Request, OfScene):
    """Which scene's versions."""


@dataclass(frozen=True)
class LookAgainRequest(LookAgainIn, OfScene):
    """What a scene is searched for once more."""


@dataclass(frozen=True)
class GetOperationRequest(Request, OfOperation):
    """Which job to show."""


@dataclass(frozen=True)
class EstimateJobRequest(Request):
    """Photos without poses that somebody thinks of sending."""

    photos: Annotated[int, Field(ge=1, description="how many")]
    width: Annotated[int, Field(description="of most, pixels; 0: 4000", json_schema_extra=_FROM_0)] = 0
    height: Annotated[int, Field(description="of most, pixels; 0: 3000", json_schema_extra=_FROM_0)] = 0
    preset: Annotated[PresetName | None, Field(description="as in SceneOptions")] = None


@dataclass(frozen=True)
class ListOperationsRequest(Request, InPages):
    """Which page of which operations."""

    state: Annotated[OperationState | None, Field(description="only those in this state")] = None


@dataclass(frozen=True)
class CancelOperationRequest(Request, OfOperation):
    """Which job to stop."""


@dataclass(frozen=True)
class RetryOperationRequest(RetryIn, OfOperation):
    """How a failed or cancelled job is tried again."""


@dataclass(frozen=True)
class FinishOperationRequest(Request, OfOperation):
    """Which job to end early."""


@dataclass(frozen=True)
class GetPreviewRequest(Request, OfOperation):
    """Of which job to show the newest picture."""


@dataclass(frozen=True)
class GetPlacedCamerasRequest(Request, OfOperation):
    """Of which job to show the cameras."""


@dataclass(frozen=True)
class WaitOperationRequest(Request, OfOperation):
    """Which job to wait for."""

    timeout_s: Annotated[float, Field(description="seconds to wait at most, 0..300")] = 0.0


@dataclass(frozen=True)
class WatchOperationRequest(Request, OfOperation):
    """Which job to watch."""


@dataclass(frozen=True)
class ListPhotosRequest(Request, InPages, OfVersion):
    """Which page of a scene's photos."""


@dataclass(frozen=True)
class DownloadPhotoRequest(Request, OfVersion):
    """Which photo of a scene."""

    view: Annotated[str, Field(description="name of one of the scene's own cameras")] = ""


@dataclass(frozen=True)
class ListNextPhotosRequest(Request, OfVersion):
    """Where to stand for the next photos of which scene."""


@dataclass(frozen=True)
class ListBestViewsRequest(Request, OfVersion):
    """What the cameras shall show."""

    object_ids: Annotated[Many[int], Field(description="ids of objects, parts or groups, seen together")] = ()
    text: Annotated[str, Field(description="instead of objects: those that answer it")] = ""
    max_views: Annotated[
        int, Field(description="at most so many, up to 16; 0: 3", json_schema_extra={**_FROM_0, "maximum": MAX_VIEWS})
    ] = 0


@dataclass(frozen=True)
class GetContactSheetRequest(Request, InPages, OfVersion):
    """Which sheet of a scene's objects without a name; it has 20 at most."""


@dataclass(frozen=True)
class GetGoalRequest(Request, OfVersion):
    """A place from which a robot sees which object."""

    object_id: Annotated[int, Field(description="which object or part, see SceneObject")] = 0
    robot_radius: Annotated[float, Field(description="meters; 0: 0.2", json_schema_extra=_FROM_0)] = 0.0


@dataclass(frozen=True)
class ListDetectionsRequest(Request, InPages, OfVersion):
    """Which page of a scene's objects as a robot needs them."""


@dataclass(frozen=True)
class ListKeysRequest(Request, InPages):
    """Which page of the project's keys."""

    scene_id: Annotated[str, Field(description="only keys that show this scene alone; empty: all")] = ""


@dataclass(frozen=True)
class RevokeKeyRequest(Request, OfKey):
    """Which key to take back."""


@dataclass(frozen=True)
class ListKnownNamesRequest(Request, InPages):
    """Which page of known names."""


@dataclass(frozen=True)
class DeleteKnownNameRequest(Request):
    """Which name to suggest no more."""

    name_id: Annotated[str, Field(description="which name; `all`: every name of the project")]
