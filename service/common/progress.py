"""Progress events of long work."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class ProgressEvent:
    """The progress of one stage at one moment.

    Attributes:
        stage: name of a stage, see `workers.job_kinds`.
        fraction: share of this stage that is done, 0..1.
        message: a short line for people, e.g. "matching image pairs 120/276".
        metrics: figures worth watching (loss, psnr, gaussians, iterations_per_second; and job_seconds_left,
            until the whole job is done).
        files: what can be looked at from now on, by kind, see `OperationRecord.progress_files`.
    """

    stage: str
    fraction: float
    message: str
    metrics: Mapping[str, float] = field(default_factory=dict)
    files: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


Progress = Callable[[ProgressEvent], None]
"""Receives events; may raise `CancelledError` to stop the work at a safe point."""


def silent(event: ProgressEvent) -> None:
    """A `Progress` that ignores every event."""
