"""Rows as frozen values: what the store takes and gives. JSON parts are plain dicts and lists."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fastsplat_contract.operations import OperationState
from fastsplat_contract.scenes import Scale, SceneState


@dataclass(frozen=True)
class SceneRecord:
    """One scene. `version` is empty until it is READY; times are seconds since 1970, UTC."""

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


@dataclass(frozen=True)
class OperationRecord:
    """One training job. `stages` and `error` are JSON as the worker wrote them; `attempt` is the fence.

    Higher priorities run first.
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


@dataclass(frozen=True)
class NewJob:
    """What makes a scene and its operation, both at once."""

    scene_id: str
    operation_id: str
    name: str
    request_id: str
    request_digest: str
    upload_id: str
    options: Mapping[str, Any]
    priority: int = 0


@dataclass(frozen=True)
class SceneSummary:
    """What a finished job says about its scene; the artefact itself is a folder of this version."""

    version: str
    gaussians: int
    scale: Scale
    dictionary: Sequence[Mapping[str, Any]]
    cameras: Sequence[Mapping[str, Any]]
    quality: Mapping[str, Any]


@dataclass(frozen=True)
class WorkerRecord:
    """One worker process. Times are seconds since 1970, UTC; a worker that has resigned beat at 0."""

    executor_id: str
    host: str
    pid: int
    started_at: float
    beat_at: float

    def silent(self, stale_s: float, now: float) -> bool:
        """Whether its last beat is older than `stale_s` seconds at time `now`."""
        return self.beat_at < now - stale_s
