"""Errors of the processes around a job."""

from __future__ import annotations

from fastsplat.service.common.errors import FastSplatError, Kind


class TrainerCrashedError(FastSplatError):
    """The trainer process died without an error: a signal, the out-of-memory killer, a crash in native code."""

    kind = Kind.INTERNAL
    reason = "TRAINER_CRASHED"


class WorkerCrashedError(FastSplatError):
    """The worker process died each time it ran this job, so it is not run again."""

    kind = Kind.INTERNAL
    reason = "WORKER_CRASHED"
