"""The JSON that goes in and out. Field descriptions end up at /docs, with units and frames."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field


class _In(BaseModel):
    """Requests: no unknown fields, no silent conversion, no NaN."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


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
    outputs: list[Literal["mask2d", "mask3d"]] = Field(
        [], description="what to compute beside the ranking; mask2d needs cameras or views"
    )


class RenderIn(_In):
    """One picture from a free viewpoint, or from one of the scene's own cameras."""

    kind: Literal["rgb", "overlay", "relevancy", "mask"]
    text: str | None = Field(None, description="the question; every kind but rgb needs one")
    camera: PosedCamera | None = None
    view: str | None = Field(None, description="name of one of the scene's own cameras, instead of `camera`")


class StageProgress(BaseModel):
    """One stage of a job."""

    stage: str = Field(description="capture, perception, training or export")
    fraction: float = Field(description="0..1 of this stage")
    message: str
    seconds: float = Field(description="spent in this stage")
    metrics: dict[str, float]


class OperationError(BaseModel):
    """Why a job failed."""

    kind: str = Field(description="name of a google.rpc.Code")
    reason: str = Field(description="stable across releases")
    message: str
    stage: str = Field(description="the stage that failed")
    details: dict[str, str] = Field(description="any of field, limit, hint")


class Operation(BaseModel):
    """One training job (AIP-151), durable from the moment it is returned."""

    id: str
    scene_id: str
    state: Literal["QUEUED", "RUNNING", "SUCCEEDED", "FAILED", "CANCELLED"]
    done: bool = Field(description="whether the state is final")
    created_at: datetime
    updated_at: datetime
    stages: list[StageProgress] = Field(description="those begun so far, in order")
    error: OperationError | None


class DictionaryEntry(BaseModel):
    """One kind of thing in a scene."""

    label_id: int = Field(description="from 1; 0 means undetected")
    label: str
    aliases: list[str] = Field(description="other names merged into this entry")
    pixels: int = Field(description="over all label maps")
    views: int = Field(description="label maps it occurs in")
    gaussian_count: int = Field(description="Gaussians whose most probable class it is")


class SceneSummary(BaseModel):
    """A scene in a list."""

    id: str
    name: str
    state: Literal["TRAINING", "READY", "FAILED"]
    operation_id: str = Field(description="the operation that makes it")
    created_at: datetime
    gaussians: int = Field(description="G, the length of every 3D mask; 0 until ready")
    scale: Literal["METRIC", "ARBITRARY"] = Field(description="METRIC: scene units are metres")


class Scene(SceneSummary):
    """A scene; dictionary, cameras and quality are empty until it is ready."""

    dictionary: list[DictionaryEntry]
    cameras: list[PosedCamera] = Field(description="the scene's own views")
    quality: dict[str, Any] = Field(description="measured figures: psnr, ssim, images, registered, ...")


class SceneList(BaseModel):
    """One page of scenes (AIP-158), newest first."""

    scenes: list[SceneSummary]
    next_page_token: str = Field(description="empty on the last page")


class Match(BaseModel):
    """One dictionary entry held against one question."""

    label_id: int
    label: str
    relevancy: float = Field(description="0..1")
    similarity: float = Field(description="cosine, -1..1")
    nearest_negative: str = Field(description="the canonical negative that set the relevancy")
    gaussian_count: int
    relevant: bool = Field(description="passes the encoder's threshold, or was asked for by name")


class Segmentation(BaseModel):
    """COCO run-length encoding: column-major, background first, ascii counts."""

    size: tuple[int, int] = Field(description="height, width in pixels")
    counts: str


class ViewMask(BaseModel):
    """A 2D mask of one answer in one camera."""

    view: str = Field(description="the scene's camera, or empty for a free viewpoint")
    camera_index: int = Field(description="which of the request's cameras; meaningless when `view` is set")
    segmentation: Segmentation
    area: int = Field(description="pixels inside")


class Answer(BaseModel):
    """The answer to one text of one scene."""

    scene_id: str
    text: str = Field(description="as asked")
    verdict: Literal["exact", "related", "absent"] = Field(
        description="exact: the thing asked for is here; related: something close is, and its label says what; "
        "absent: nothing relevant is here"
    )
    explanation: str = Field(description="one sentence for people")
    matches: list[Match] = Field(description="every entry of the dictionary, best first")
    masks: list[ViewMask] = Field(description="cameras first, then views, each in the order asked")
    mask3d: str | None = Field(
        description="base64 of ⌈G/8⌉ bytes, one bit per Gaussian in row order, most significant bit first; "
        "null unless asked for"
    )


class QueryOut(BaseModel):
    """One answer a text; over all scenes, one a scene and text."""

    answers: list[Answer]
