"""Database rows as frozen dataclasses, with JSON columns as plain dicts and lists."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, get_args

from fastsplat.service.common.setting_groups import ModelChoice
from fastsplat.service.store.rows.damaged_rows import are_objects, is_name, is_object, require_fields
from fastsplat_contract.jobs.operations import AgainAfter, OperationKind, OperationState
from fastsplat_contract.messages.scenes import Scale, SceneState

DEFAULT_PROJECT = "default"
"""The project used when none is named; every database has it."""

SECONDS_LEFT = "job_seconds_left"
"""Stage metric: seconds until the whole job is done; -1 if unknown again."""

PREDICTED_S = "predicted_s"
"""Key of `OperationRecord.options`: how long its job was said to take, seconds, where that was known when it came."""

REASONS = (None, *get_args(AgainAfter))


@dataclass(frozen=True)
class SceneRecord:
    """A scene; times are seconds since 1970, UTC."""

    id: str
    name: str
    operation_id: str
    state: SceneState
    version: str  # "" until it can be queried; a draft, possibly edited, while not READY
    created_at: float
    gaussians: int
    scale: Scale
    dictionary: Sequence[Mapping[str, Any]]
    cameras: Sequence[Mapping[str, Any]]
    quality: Mapping[str, Any]
    project: str = DEFAULT_PROJECT
    scaling: Mapping[str, Any] | None = None
    alignment: Mapping[str, Any] | None = None
    objects: int = 0

    def __post_init__(self) -> None:
        require_fields(
            f"scene {self.id}",
            self,
            version=is_name(self.version) or (self.version == "" and self.state != "READY"),
            dictionary=are_objects(self.dictionary, "label_id", "label"),
            cameras=are_objects(self.cameras, "name"),
        )


@dataclass(frozen=True)
class OperationRecord:
    """A job; jobs with a higher priority run first.

    `stages` and `error` are JSON as the worker wrote them; `attempt` is the fencing token. `progress_files` maps a kind
    ("preview", "placed") to its "file" (see `Blobs.progress_file`) and "info" (`PreviewInfo` or `PlacedInfo` as JSON).
    A job on a finished scene has no upload but an order, and a result if it succeeded; both are JSON. Workers take it
    that offer its `gpus`, its `memory` (bytes; 0 is unknown) and, once it began, the `models` that it began with.
    """

    id: str
    scene_id: str
    state: OperationState
    request_digest: str
    upload_id: str
    options: Mapping[str, Any]
    stages: Sequence[Mapping[str, Any]]
    error: Mapping[str, Any] | None
    created_at: float
    updated_at: float
    attempt: int
    starts: int
    cancel_requested: bool
    priority: int
    kind: OperationKind = "create_scene"
    order: Mapping[str, Any] = field(default_factory=dict)
    result: Mapping[str, Any] | None = None
    retries: int = 0  # after failure or cancellation
    excluded: Sequence[str] = ()  # paths of uploaded photos that retries left out
    again_after: AgainAfter | None = None  # what ended the attempt before the newest, or before the next one
    run_after: float = 0.0  # nobody takes it before
    gpus: int = 0
    memory: int = 0
    models: ModelChoice = field(default_factory=dict)
    project: str = DEFAULT_PROJECT
    finish_requested: bool = False
    progress_files: Mapping[str, Mapping[str, Any]] | None = None

    def __post_init__(self) -> None:
        files = self.progress_files
        readable = files is None or (is_object(files) and are_objects(tuple(files.values())))
        require_fields(f"operation {self.id}", self, progress_files=readable)

    @property
    def makes_scene(self) -> bool:
        """True if the job makes its scene from an upload."""
        return self.kind == "create_scene"

    @property
    def run_id(self) -> str:
        """Name of this run, its work folder and its scene version.

        Each retry has its own, so that a late worker of an ended run cannot touch the next one's files.
        """
        return f"{self.id}.{self.retries}" if self.retries else self.id


@dataclass(frozen=True)
class QueuedJob:
    """The columns of an operation that waits by which its queue is foreseen."""

    id: str
    project: str
    cancel_requested: bool
    options: Mapping[str, Any]

    def __post_init__(self) -> None:
        require_fields(f"operation {self.id}", self)


@dataclass(frozen=True)
class NewJob:
    """A job to be created, together with its scene if it makes one."""

    scene_id: str
    operation_id: str
    name: str
    request_id: str
    request_digest: str
    upload_id: str
    options: Mapping[str, Any]
    kind: OperationKind = "create_scene"
    order: Mapping[str, Any] = field(default_factory=dict)
    priority: int = 0
    project: str = DEFAULT_PROJECT
    gpus: int = 0  # as in `OperationRecord`
    memory: int = 0


@dataclass(frozen=True)
class SceneSummary:
    """The columns of a scene that a finished job writes."""

    version: str
    gaussians: int
    scale: Scale
    dictionary: Sequence[Mapping[str, Any]]
    cameras: Sequence[Mapping[str, Any]]
    quality: Mapping[str, Any]
    objects: int


@dataclass(frozen=True)
class WorkerRecord:
    """A worker process."""

    executor_id: str
    host: str
    pid: int
    started_at: float  # seconds since its machine booted
    heartbeat_at: float  # seconds since 1970 by its clock; 0 once it has stopped by itself
