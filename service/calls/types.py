"""What the service layer takes and gives. Both faces translate these to their wire formats, and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from io import BytesIO
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.common.camera import PosedCamera
from fastsplat.service.common.options import SceneOptions as SceneOptions
from fastsplat.service.common.states import OperationState, SceneState
from fastsplat.service.query.rle import decode_rle
from fastsplat.service.query.types import Answer

Output = Literal["mask2d", "mask3d", "objects"]
MaskEncoding = Literal["rle", "png"]
Mask3dEncoding = Literal["bits", "runs", "indices", "ply"]
PictureKind = Literal["rgb", "overlay", "relevancy", "mask", "label_map", "depth", "depth_picture"]
PictureFormat = Literal["png", "npy"]
CameraFormat = Literal["json", "transforms", "colmap"]
EditAction = Literal["recolour", "remove", "move", "duplicate"]
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True)
class StageProgress:
    """One stage of an operation; `seconds` counts while it runs."""

    stage: str
    fraction: float
    message: str
    seconds: float
    metrics: Mapping[str, float]


@dataclass(frozen=True)
class OperationError:
    """Why a job failed: the error's reason, message and details, and the stage it failed in."""

    kind: str
    reason: str
    message: str
    stage: str
    details: Mapping[str, str]


@dataclass(frozen=True)
class Operation:
    """One training job, durable from the moment it is returned."""

    id: str
    scene_id: str
    state: OperationState
    created_at: datetime
    updated_at: datetime
    stages: tuple[StageProgress, ...]
    error: OperationError | None

    @property
    def done(self) -> bool:
        """Whether the state is final."""
        return self.state in ("SUCCEEDED", "FAILED", "CANCELLED")


@dataclass(frozen=True)
class DictionaryRow:
    """One label of a scene, with how much of it the label maps and the Gaussians hold."""

    label_id: int
    label: str
    aliases: tuple[str, ...]
    pixels: int
    views: int
    gaussian_count: int


@dataclass(frozen=True)
class SceneInfo:
    """A scene as listed. `dictionary`, `cameras`, `quality` and `version` are empty until `state` is READY.

    Of very many labels and cameras only the first stand here; the counts are of all (of cameras, 0 in lists).
    """

    id: str
    name: str
    state: SceneState
    operation_id: str
    created_at: datetime
    gaussians: int
    scale: Literal["METRIC", "ARBITRARY"]
    dictionary: tuple[DictionaryRow, ...]
    cameras: tuple[PosedCamera, ...]
    quality: Mapping[str, Any]
    version: str
    label_count: int
    camera_count: int


@dataclass(frozen=True)
class Pose:
    """A rigid pose in the world frame: position x y z in scene units, unit quaternion x y z w."""

    position: Vector
    orientation: Quaternion


@dataclass(frozen=True)
class Box:
    """An oriented box: the pose of its middle (orientation rotates box axes into world axes) and whole edge lengths."""

    center: Pose
    size: Vector


@dataclass(frozen=True)
class SceneObject:
    """One thing: connected Gaussians of one label. As vision_msgs/Detection3D.

    Attributes:
        id: stable within a version of a scene.
        score: how sure its Gaussians are of the label, 0..1.
        centroid: world frame, scene units.
        metres: whether lengths are metres.
        best_views: names of the scene's cameras that see it best, best first.
    """

    id: str
    label_id: int
    label: str
    score: float
    centroid: Vector
    box: Box
    gaussian_count: int
    metres: bool
    best_views: tuple[str, ...]


@dataclass(frozen=True)
class Edit:
    """What to do to everything of a label, or to one object.

    Attributes:
        action: what.
        label, object_id: to what; exactly one of the two.
        colour: RGB 0..1, for "recolour".
        transform: for "move" and "duplicate", the rigid motion x' = R x + t in the world frame.
    """

    action: EditAction
    label: str | None = None
    object_id: str | None = None
    colour: Vector | None = None
    transform: Pose | None = None


@dataclass(frozen=True)
class SceneVersion:
    """One state of a scene; never changes.

    Attributes:
        parent: the version it was made of; "" for the trained one.
        gaussians: G.
        current: whether questions that name no version go here.
        edits: what made it of its parent.
    """

    scene_id: str
    version: str
    parent: str
    created_at: datetime
    gaussians: int
    current: bool
    edits: tuple[Edit, ...]


@dataclass(frozen=True)
class QueryRequest:
    """One or several texts asked of one scene.

    Attributes:
        scene_id: which scene.
        texts: the questions.
        cameras: free viewpoints for 2D masks.
        views: names of the scene's own cameras for 2D masks.
        outputs: what to compute beside the ranking: "mask2d" needs a camera or a view; the others do not.
        version: of the scene; "" is the current one.
        negatives, templates: in place of the settings' own; empty leaves them.
        coverage: of the label set, in (0, 1), or None for the settings' own.
        max_matches: best entries to return; 0 is the settings' own number, -1 means all.
        mask2d_encoding, mask3d_encoding: see `QueryAnswer` and `ViewMask`.
    """

    scene_id: str
    texts: tuple[str, ...]
    cameras: tuple[PosedCamera, ...] = ()
    views: tuple[str, ...] = ()
    outputs: frozenset[Output] = frozenset()
    version: str = ""
    negatives: tuple[str, ...] = ()
    templates: tuple[str, ...] = ()
    coverage: float | None = None
    max_matches: int = 0
    mask2d_encoding: MaskEncoding = "rle"
    mask3d_encoding: Mask3dEncoding = "bits"


@dataclass(frozen=True)
class RleMask:
    """COCO run-length encoding: size [height, width], column-major, background first, ascii counts."""

    height: int
    width: int
    counts: str


@dataclass(frozen=True)
class ViewMask:
    """A 2D mask of one answer in one camera; `view` is its name, "" for a free viewpoint given at `camera_index`.

    Attributes:
        area: pixels inside.
        rle: the mask, unless PNG was asked for.
        png: the mask as 8-bit grey, 255 inside, if asked for; else empty.
    """

    view: str
    camera_index: int
    area: int
    rle: RleMask | None
    png: bytes = b""

    def array(self) -> NDArray[np.bool_]:
        """bool [H, W]."""
        if self.rle is not None:
            return decode_rle(self.rle.counts, self.rle.height, self.rle.width)
        return np.asarray(Image.open(BytesIO(self.png))) > 0


@dataclass(frozen=True)
class QueryAnswer:
    """The ranked answer of one text with what else was asked for.

    Attributes:
        scene_id, version: what answered.
        answer: verdict and the best entries.
        match_count: entries in the whole dictionary.
        gaussians: G, the length of the 3D mask.
        masks: 2D masks in the order cameras, then views; empty unless asked for.
        mask3d: the Gaussians that answer; empty unless asked for. "bits": packed, most significant first, one per
            Gaussian in row order; "runs": little-endian uint32 lengths of alternating runs, outside first; "indices":
            little-endian uint32 row numbers, ascending; "ply": a 3DGS PLY of just these.
        objects: the things that answer, by label in the order of the matches; empty unless asked for.
    """

    scene_id: str
    version: str
    answer: Answer
    match_count: int
    gaussians: int
    masks: tuple[ViewMask, ...] = ()
    mask3d: bytes = b""
    objects: tuple[SceneObject, ...] = ()
