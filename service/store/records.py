"""Rows of the database as frozen values. JSON parts are plain dicts and lists. One that cannot be what it says raises
`SceneFileError` (a scene, a version) or `ArtefactError`, see `damaged_rows`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

from fastsplat.service.store.damaged_rows import are_objects, is_name, is_object, is_time, require
from fastsplat_contract.operations import AgainAfter, OperationKind, OperationState
from fastsplat_contract.scenes import Scale, SceneState

DEFAULT_PROJECT = "default"
"""The project of those who name none; every database has it."""

SECONDS_LEFT = "job_seconds_left"
"""The metric of a stage that speaks of the whole job: seconds until it is done, -1 where that is not known any more."""

PREDICTED_S = "predicted_s"
"""Key of `OperationRecord.options`: how long its job was said to take, seconds, where that was known when it came."""

RESULT = "result"
"""Key of `OperationRecord.options` that only jobs on finished scenes have: what came of it. The order is under the name
of the job's kind."""

RETRIES = "retries"
EXCLUDED = "exclude"
AGAIN_AFTER = "again_after"
RELEASED = "released"
"""Keys of `OperationRecord.options` that the queue writes; `RELEASED`: its worker was told to stop and gave it back."""

_SCENE_STATES, _OPERATION_STATES, _SCALES = get_args(SceneState), get_args(OperationState), get_args(Scale)
_KINDS: tuple[OperationKind, ...] = get_args(OperationKind)


@dataclass(frozen=True)
class SceneRecord:
    """One scene. `version` is empty as long as nothing of it can be asked; that of a scene that is not READY
    is a draft, or what one was edited to. Times are seconds since 1970, UTC."""

    id: str
    name: str
    operation_id: str
    state: SceneState
    version: str
    created_at: float
    gaussians: int
    scale: Scale
    dictionary: Sequence[Mapping[str, Any]]
    cameras: Sequence[Mapping[str, Any]]
    quality: Mapping[str, Any]
    project: str = DEFAULT_PROJECT
    scaling: Mapping[str, Any] | None = None
    alignment: Mapping[str, Any] | None = None
    things: int = 0

    def __post_init__(self) -> None:
        require(
            f"scene {self.id}",
            name=isinstance(self.name, str),
            operation_id=isinstance(self.operation_id, str),
            state=self.state in _SCENE_STATES,
            version=is_name(self.version) or (self.version == "" and self.state != "READY"),
            created_at=is_time(self.created_at),
            gaussians=isinstance(self.gaussians, int),
            scale=self.scale in _SCALES,
            dictionary=are_objects(self.dictionary, "label_id", "label"),
            cameras=are_objects(self.cameras, "name"),
            quality=is_object(self.quality),
            scaling=self.scaling is None or is_object(self.scaling),
            alignment=self.alignment is None or is_object(self.alignment),
            things=isinstance(self.things, int),
        )


@dataclass(frozen=True)
class OperationRecord:
    """One job. `stages` and `error` are JSON as the worker wrote them; `attempt` is the fencing token.

    `progress_files` has what can be looked at while the job runs, by kind ("preview", "placed"): the "file" (see
    `Blobs.progress_file`), and "info", a `PreviewInfo` or `PlacedInfo` as JSON.

    Higher priorities run first. A job on a finished scene has no upload but an order.
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
    project: str = DEFAULT_PROJECT
    finish_requested: bool = False
    progress_files: Mapping[str, Mapping[str, Any]] | None = None

    def __post_init__(self) -> None:
        options = self.options if is_object(self.options) else {}
        require(
            f"operation {self.id}",
            scene_id=isinstance(self.scene_id, str),
            state=self.state in _OPERATION_STATES,
            upload_id=isinstance(self.upload_id, str),
            options=is_object(self.options)
            and isinstance(options.get("retries", 0), int)
            and all(options.get(key) is None or is_object(options[key]) for key in (*_KINDS, RESULT)),
            stages=are_objects(self.stages),
            error=self.error is None or is_object(self.error),
            created_at=is_time(self.created_at),
            updated_at=is_time(self.updated_at),
            attempt=isinstance(self.attempt, int),
            starts=isinstance(self.starts, int),
            priority=isinstance(self.priority, int),
            progress_files=self.progress_files is None
            or (is_object(self.progress_files) and are_objects(tuple(self.progress_files.values()))),
        )

    @property
    def retries(self) -> int:
        """How often the job was queued again after it had failed or was cancelled."""
        return int(self.options.get(RETRIES, 0))

    @property
    def excluded(self) -> tuple[str, ...]:
        """Paths of the photos of its upload that retries asked to leave out."""
        return tuple(self.options.get(EXCLUDED, ()))

    @property
    def again_after(self) -> AgainAfter | None:
        """What ended the attempt before; None in the first one."""
        after: AgainAfter | None = self.options.get(AGAIN_AFTER)
        return after

    @property
    def kind(self) -> OperationKind:
        """What the job does; one without an order makes its scene."""
        return next((kind for kind in _KINDS if self.options.get(kind) is not None), "create_scene")

    @property
    def makes_scene(self) -> bool:
        """Whether the job makes its scene, of an upload; others work on a finished one."""
        return self.kind == "create_scene"

    @property
    def order(self) -> Mapping[str, Any]:
        """What was ordered of a job on a finished scene, as JSON; empty for one that makes its scene."""
        return self.options.get(self.kind) or {}

    @property
    def result(self) -> Mapping[str, Any] | None:
        """What came of a job on a finished scene, as JSON; None as long as there is nothing."""
        found: Mapping[str, Any] | None = self.options.get(RESULT)
        return found

    @property
    def run_id(self) -> str:
        """Name of this run of the job, of its work folder and of the scene's version that it makes.

        Each retry is a run of its own, so that what a late worker of an ended run writes or removes is not the next
        run's.
        """
        return f"{self.id}.{self.retries}" if self.retries else self.id


@dataclass(frozen=True)
class NewJob:
    """A scene and its operation, to be created together."""

    scene_id: str
    operation_id: str
    name: str
    request_id: str
    request_digest: str
    upload_id: str
    options: Mapping[str, Any]
    priority: int = 0
    project: str = DEFAULT_PROJECT


@dataclass(frozen=True)
class SceneSummary:
    """What a finished job stores about its scene; the artefact itself is a folder of this version."""

    version: str
    gaussians: int
    scale: Scale
    dictionary: Sequence[Mapping[str, Any]]
    cameras: Sequence[Mapping[str, Any]]
    quality: Mapping[str, Any]
    things: int


@dataclass(frozen=True)
class WorkerRecord:
    """One worker process.

    Attributes:
        executor_id: its name.
        host, pid: the machine it runs on, and its process id there.
        started_at: when it registered, in seconds after the boot of its machine.
        heartbeat_at: in seconds since 1970 by its own clock; 0 once it has stopped by itself.
    """

    executor_id: str
    host: str
    pid: int
    started_at: float
    heartbeat_at: float
