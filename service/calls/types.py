"""What the service layer takes and gives. Both faces translate these to their wire formats, and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal

from service.common.camera import PosedCamera
from service.query.types import Answer

OperationState = Literal["QUEUED", "RUNNING", "SUCCEEDED", "FAILED", "CANCELLED"]


@dataclass(frozen=True)
class SceneOptions:
    """What a user may choose when posting a scene.

    Attributes:
        labels: names to look for; empty lets the settings' prompt source decide.
        time_budget_s: training seconds, or None for the server's default.
        max_gaussians: hard budget, or None for the server's default.
    """

    labels: tuple[str, ...] = ()
    time_budget_s: float | None = None
    max_gaussians: int | None = None


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
    """A scene as listed. `dictionary`, `cameras` and `quality` are empty until `state` is READY."""

    id: str
    name: str
    state: Literal["TRAINING", "READY", "FAILED"]
    operation_id: str
    created_at: datetime
    gaussians: int
    scale: Literal["METRIC", "ARBITRARY"]
    dictionary: tuple[DictionaryRow, ...]
    cameras: tuple[PosedCamera, ...]
    quality: Mapping[str, Any]


@dataclass(frozen=True)
class QueryRequest:
    """One or several texts asked of one scene.

    Attributes:
        scene_id: which scene.
        texts: the questions.
        cameras: free viewpoints for 2D masks.
        views: names of the scene's own cameras for 2D masks.
        outputs: what to compute beside the ranking: "mask2d" needs a camera or a view; "mask3d" does not.
    """

    scene_id: str
    texts: tuple[str, ...]
    cameras: tuple[PosedCamera, ...] = ()
    views: tuple[str, ...] = ()
    outputs: frozenset[Literal["mask2d", "mask3d"]] = frozenset()


@dataclass(frozen=True)
class RleMask:
    """COCO run-length encoding: size [height, width], column-major, background first, ascii counts."""

    height: int
    width: int
    counts: str


@dataclass(frozen=True)
class ViewMask:
    """A 2D mask of one answer in one camera; `view` is its name, "" for a free viewpoint given at `camera_index`."""

    view: str
    camera_index: int
    rle: RleMask
    pixels: int


@dataclass(frozen=True)
class QueryAnswer:
    """The ranked answer of one text with the masks that were asked for.

    Attributes:
        scene_id: which scene answered.
        answer: verdict and ranked entries.
        masks: 2D masks in the order cameras, then views; empty unless asked for.
        mask3d: packed bits, most significant first, one per Gaussian in row order; empty unless asked for.
    """

    scene_id: str
    answer: Answer
    masks: tuple[ViewMask, ...]
    mask3d: bytes
