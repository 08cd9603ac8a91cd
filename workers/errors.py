"""What goes wrong around a job, rather than in it."""

from __future__ import annotations

from fastsplat.service.common.errors import FastSplatError, Kind


class TrainerCrashedError(FastSplatError):
    """The trainer process died without a word: a signal, the out-of-memory killer, a crash in native code."""

    kind = Kind.INTERNAL
    reason = "TRAINER_CRASHED"


class WorkerCrashedError(FastSplatError):
    """The worker process died each time it ran this job, so the job is parked."""

    kind = Kind.INTERNAL
    reason = "WORKER_CRASHED"
