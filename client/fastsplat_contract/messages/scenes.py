"""Scenes: their dictionary, their versions and the edits that make them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Int64, Many, Request, Response, travels
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.gaussian_filters import GaussianFilter
from fastsplat_contract.geometry.object_prompts import ObjectPrompt, PromptedObject
from fastsplat_contract.geometry.places import Alignment, KnownLength, KnownSize
from fastsplat_contract.geometry.poses import Pose, Vector3
from fastsplat_contract.jobs.job_watching import Provisional
from fastsplat_contract.jobs.name_suggestions import SuggestedName
from fastsplat_contract.messages.assessments import Assessment

SceneState = Literal["TRAINING", "READY", "FAILED", "CANCELLED"]
Scale = Literal["METRIC", "ARBITRARY"]
EditAction = Literal[
    "recolor", "remove", "move", "duplicate", "name", "unname", "merge", "discard", "insert", "split", "add",
    "scale", "align", "look_again", "observe", "suggest",
]  # fmt: skip

NextPageToken = Annotated[str, Field(description="empty on the last page")]
Version = Annotated[str, Field(description="of the scene; empty: the current one")]


@dataclass(frozen=True)
class OfScene:
    """What a request says in its path, or, over gRPC, in its message."""

    scene_id: Annotated[str, Field(description="which scene")]


@dataclass(frozen=True)
class DictionaryEntry(Response):
    """One kind of object in a scene."""

    label_id: Annotated[int, Field(description="from 1; 0 means undetected")]
    label: str
    aliases: Annotated[Many[str], Field(description="other names merged into this entry")]
    pixels: Annotated[Int64, Field(description="over all label maps")]
    views: Annotated[int, Field(description="label maps it occurs in")]
    gaussian_count: Annotated[
        Int64,
        Field(description="Gaussians whose most probable class it is; 0: it was looked for, and nothing here is it"),
    ]


@travels(request=False, proto="ListLabelsResponse")
class LabelList(NamedTuple):
    """One page of a scene's dictionary, by label id."""

    labels: Many[DictionaryEntry]
    next_page_token: NextPageToken


@dataclass(frozen=True)
class SceneSummary(Response):
    """A scene in a list."""

    proto: ClassVar[str] = "Scene"

    id: str
    name: str
    state: SceneState
    operation_id: Annotated[str, Field(description="the operation that makes it")]
    created_at: datetime
    gaussians: Annotated[Int64, Field(description="G, the length of every 3D mask; 0 without a version")]
    scale: Annotated[
        Scale,
        Field(
            description="METRIC: scene units are meters; ARBITRARY: poses came from images alone, lengths have no unit"
        ),
    ]
    version: Annotated[str, Field(description="the current version; empty as long as there is nothing to be asked")]
    label_count: Annotated[int, Field(description="length of the whole dictionary")]
    object_count: Annotated[int | None, Field(description="surfaces left out; absent without a version")]
    captured_at: Annotated[
        datetime | None,
        Field(
            description="when the newest photo of its capture was taken; absent where the photos do not say it: "
            "`created_at` then counts"
        ),
    ]


ScaleSource = Literal["known_length", "tags", "sensor_depth", "arkit", "gps", "point_pairs"]
"""What said how long a unit is."""

VerticalSource = Literal["metadata", "horizon", "planes", "cameras"]
"""What said which way is up."""


@dataclass(frozen=True)
class SceneVertical(Response):
    """Which way is up in a scene's current version, and how sure that is."""

    source: Annotated[
        VerticalSource,
        Field(
            description="metadata: sensors, as the photos' metadata have them; horizon: cameras that were held level; "
            "planes: floors, tables and other level planes; cameras: the mean of what the cameras had for up, the "
            "least sure"
        ),
    ]
    deviation_deg: Annotated[float, Field(description="1 sigma of the angle between `up` and the vertical, degrees")]
    up: Annotated[
        Vector3, Field(description="unit vector in the version's world frame; +z unless poses came along, or a map")
    ]


@travels(request=False)
class SceneScaling(NamedTuple):
    """How the unit of a scene's current version came to be a meter."""

    source: Annotated[
        ScaleSource,
        Field(
            description="known_length: lengths that a person knew; tags: printed tags in the photos; sensor_depth: "
            "maps of a depth sensor; arkit: a phone's tracking; gps: the places in the photos' EXIF; point_pairs: "
            "points of a map; of several the surest"
        ),
    ]
    meters_per_unit: Annotated[
        float, Field(description="of the scene as it was trained; lengths of this version are multiplied by it")
    ]
    low: Annotated[float, Field(description="of the 95 % interval of `meters_per_unit`")]
    high: Annotated[float, Field(description="of the 95 % interval of `meters_per_unit`")]
    known_lengths: Annotated[int, Field(description="that it comes from, beside tags")]


@travels(request=False)
class SceneAlignment(NamedTuple):
    """How a scene's current version lies in the frame of a map."""

    frame: Annotated[str, Field(description="the map frame's name; may be empty")]
    pairs: Annotated[int, Field(description="of points that it comes from; 0: the motion was given")]
    rms: Annotated[
        float | None,
        Field(description="root mean square of the pairs' residuals, outliers left out, scene units; absent without"),
    ]
    residuals: Annotated[Many[float], Field(description="of each pair, scene units")]
    outliers: Annotated[Many[int], Field(description="numbers of the pairs, from 0, that fit the others badly")]
    transform: Annotated[
        Pose, Field(description="x' = R (s x) + t from the trained version's world frame, s = meters_per_unit or 1")
    ]


@dataclass(frozen=True)
class Scene(SceneSummary):
    """A scene; dictionary, cameras and quality are empty as long as it has no version."""

    camera_count: Annotated[int, Field(description="number of the scene's own cameras")]
    dictionary: Annotated[
        Many[DictionaryEntry], Field(description="the first 5,000 by label id; the list of labels has all")
    ]
    cameras: Annotated[
        Many[PosedCamera], Field(description="the scene's own views, the first 5,000; the camera file has all")
    ]
    quality: Annotated[Mapping[str, Any], Field(description="measured figures: psnr, ssim, images, registered, ...")]
    assessment: Annotated[
        Assessment | None,
        Field(description="how good the scene is; absent until it is ready, and where nothing was measured"),
    ] = None
    scaling: Annotated[
        SceneScaling | None,
        Field(description="absent where the poses came in meters, or nothing says how long a unit is"),
    ] = None
    vertical: Annotated[SceneVertical | None, Field(description="absent where nothing says what is up")] = None
    alignment: Annotated[
        SceneAlignment | None, Field(description="absent where the scene was not put into the frame of a map")
    ] = None
    provisional: Annotated[
        Provisional | None,
        Field(description="of a scene that is not ready: what its version, a draft, is made of; absent without one"),
    ] = None


@travels(request=False, proto="ListScenesResponse")
class SceneList(NamedTuple):
    """One page of scenes (AIP-158), newest first."""

    scenes: Many[SceneSummary]
    next_page_token: NextPageToken


@dataclass(frozen=True)
class SceneUpdate(Request):
    """What people change about a scene itself."""

    proto: ClassVar[str] = "UpdateSceneRequest"

    name: Annotated[str, Field(description="its new name, for people; need not be unique")]
    expected_name: Annotated[
        str | None,
        Field(description="only if its name is still this one, or already the new one; absent: whatever it is"),
    ] = None


@travels(request=True)
class Color(NamedTuple):
    """RGB, each 0 to 1."""

    r: Annotated[float, Field(ge=0, le=1)]
    g: Annotated[float, Field(ge=0, le=1)]
    b: Annotated[float, Field(ge=0, le=1)]


@dataclass(frozen=True)
class InsertSource(Request):
    """The scene that inserted objects come from."""

    scene_id: Annotated[str, Field(description="of the same project")]
    version: Annotated[str, Field(description="of that scene; empty: its current one")] = ""


@dataclass(frozen=True)
class Edit(Request):
    """What to do to everything of a label, or to objects."""

    action: Annotated[
        EditAction,
        Field(
            description="recolor, remove, move, duplicate: change what is seen. name, unname, merge, discard: change "
            "what it is taken for; merge makes the objects one under the first one's id and name; discard leaves their "
            "Gaussians, which then belong to no object. insert: adds objects of another scene, which get new ids. "
            "split: makes the piece of an object that a prompt shows an object of its own; add: makes what a prompt "
            "shows an object, whatever its Gaussians belonged to. scale: makes the scene's units meters by known "
            "lengths or sizes, those of earlier such edits included; Gaussians, boxes and cameras are scaled with it. "
            "align: puts the scene into the frame of a map, by a rigid motion or by pairs of points. suggest: names "
            "that objects may have, which can be asked for and which nothing bears until a person gives them. "
            "look_again and observe: stand in the versions that such calls have made, and are no edits to send"
        ),
    ]
    label: str | None = None
    color: Annotated[Color | None, Field(description="for recolor: RGB, each 0 to 1")] = None
    transform: Annotated[
        Pose | None,
        Field(
            description="for move and duplicate: the rigid motion x' = R x + t in the world frame, of what is moved "
            "or of its copy; for insert: from the other scene's world frame and units into this one's"
        ),
    ] = None
    object_ids: Annotated[
        Many[int], Field(description="ids of objects, instead of `label`; merge: the first one's id stays")
    ] = ()
    name: Annotated[
        str | None,
        Field(
            description="for name, split and add (of the new object): one line of 1 to 200 characters; objects of one "
            "name have one label"
        ),
    ] = None
    aliases: Annotated[Many[str], Field(description="with a name: other names of the same label")] = ()
    kinds: Annotated[
        Many[str],
        Field(
            description="with a name that says nothing of what it is, as Oskar: what it is, as teddy bear and toy. It "
            "is then found by these words and what they are kinds of; each becomes an alias of the name and the kind"
        ),
    ] = ()
    source: Annotated[
        InsertSource | None, Field(description="for insert: the other scene; label and objects are then of that one")
    ] = None
    prompt: Annotated[
        ObjectPrompt | None,
        Field(description="for split and add: where the piece, or the missing object, is in a picture"),
    ] = None
    texts: Annotated[Many[str], Field(description="for look_again: what was looked for")] = ()
    known_lengths: Annotated[
        Many[KnownLength], Field(description="for scale: lengths that somebody has measured in the world")
    ] = ()
    known_sizes: Annotated[
        Many[KnownSize], Field(description="for scale: objects whose size somebody has measured in the world")
    ] = ()
    alignment: Annotated[Alignment | None, Field(description="for align: how the scene lies in a map")] = None
    filter: Annotated[
        GaussianFilter | None,
        Field(
            description="for remove: only the Gaussians that it takes, of the label or objects if there is one "
            "and otherwise of the whole scene; what objects enclose stays then"
        ),
    ] = None
    suggestions: Annotated[
        Many[SuggestedName],
        Field(
            description="for suggest: names for objects, at most five of a source for an object; what a source says "
            "of an object replaces what it said before"
        ),
    ] = ()


@dataclass(frozen=True)
class EditIn(Request):
    """A new version of a scene."""

    proto: ClassVar[str] = "EditSceneRequest"

    edits: Annotated[Many[Edit], Field(description="at least one, applied in order")]
    request_id: Annotated[str, Field(description="same id: the version that it made is returned again (AIP-155)")] = ""
    version: Annotated[
        str,
        Field(
            description="the version that was looked at. The edits are made of the current one either way; a name that "
            "a person gave an object is replaced only if it stood in this version"
        ),
    ] = ""


@dataclass(frozen=True)
class UndoIn(Request):
    """Back to the version before the current one."""

    proto: ClassVar[str] = "UndoEditRequest"

    version: Annotated[str, Field(description="undo only if this is the current version; makes a retry safe")] = ""


@dataclass(frozen=True)
class RedoIn(Request):
    """Forward to the version that was undone: of those made of the current one, the one that was current last."""

    proto: ClassVar[str] = "RedoEditRequest"

    version: Annotated[str, Field(description="redo only if this is the current version; makes a retry safe")] = ""


@dataclass(frozen=True)
class RestoreIn(Request):
    """Make any version of a scene the current one; all others stay."""

    proto: ClassVar[str] = "RestoreVersionRequest"

    version: Annotated[str, Field(description="to become current")]
    expected: Annotated[str, Field(description="restore only if this is the current version; empty: always")] = ""


@dataclass(frozen=True)
class SceneVersion(Response):
    """One state of a scene; never changes."""

    scene_id: str
    version: str
    parent: Annotated[str, Field(description="the version it was made of; empty for the trained one")]
    created_at: datetime
    gaussians: Int64
    current: Annotated[bool, Field(description="whether questions that name no version go here")]
    edits: Annotated[Many[Edit], Field(description="what made it of its parent")]
    prompted: Annotated[Many[PromptedObject], Field(description="what those edits made of their prompts")] = ()
    author: Annotated[str, Field(description="the name of the key that made it; empty where that is unknown")] = ""
    asks_kind: Annotated[
        bool,
        Field(
            description="whether an edit of it gave a name of which no word is known, so that it is found by this name "
            "alone until its `kinds` are said"
        ),
    ] = False


@travels(request=False, proto="ListVersionsResponse")
class VersionList(NamedTuple):
    """Every version of a scene, oldest first."""

    versions: Many[SceneVersion]
