"""Progress events of long-running work."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class ProgressEvent:
    """Progress of one stage at one moment.

    Attributes:
        metrics: loss, psnr, gaussians, iterations_per_second, and job_seconds_left until the whole job is done.
        files: files that can be viewed from now on, by kind, see `OperationRecord.progress_files`.
    """

    stage: str  # see `workers.kinds.job_kinds`
    fraction: float  # of this stage, 0..1
    message: str  # short line for people, e.g. "matching image pairs 120/276"
    metrics: Mapping[str, float] = field(default_factory=dict)
    files: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


Progress = Callable[[ProgressEvent], None]
"""Receives events; may raise `CancelledError` to stop the work at a safe point."""


def silent(event: ProgressEvent) -> None:
    """Ignores every event."""
