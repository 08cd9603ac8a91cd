"""Trainer process, `python -m fastsplat.workers.engine.trainer`: runs one job, then exits.

The first stdin line is its spec; stdin stays open while its supervisor lives. Events leave as JSON lines on the
original stdout; output of native code goes to stderr, the job's log.
"""

from __future__ import annotations

import io
import os
import pkgutil
import sys
import time
from dataclasses import replace
from typing import TYPE_CHECKING

from fastsplat.service.common.process import PARENT_VARIABLE, die_with_parent, yield_to_others
from fastsplat.workers.engine.process_group import fork_group_guard

if TYPE_CHECKING:
    from collections.abc import Callable

    from fastsplat.service.common.progress import ProgressEvent
    from fastsplat.workers.job.protocol import Event, Job

_PROGRESS_S = 0.1


def main() -> int:
    """Runs a job's missing stages; returns 0 if all are done, 1 if one failed."""
    die_with_parent(int(os.environ[PARENT_VARIABLE]))
    events = os.dup(1)
    os.dup2(2, 1)
    spec = io.FileIO(0, closefd=False).readline()  # and no byte more, which the guard reads
    if not spec.endswith(b"\n"):
        return 1
    fork_group_guard()

    from fastsplat.workers.job.protocol import event_to_line, read_job

    job, run = read_job(spec)
    yield_to_others(job.settings.jobs.niceness)  # API requests on this machine take precedence
    return _run(job, run, lambda event: _write(events, event_to_line(event)))


def _run(job: Job, run: str, send: Callable[[Event], None]) -> int:
    from fastsplat.service.common.progress import ProgressEvent
    from fastsplat.workers.job.protocol import Done, Failed
    from fastsplat.workers.job.results import discard_damaged, finish_stage, operation_error, start_stage

    progress = _throttled(send)
    stage = job.stages[0]
    try:
        discard_damaged(job)
        for stage in job.stages:
            if job.result(stage).is_dir():
                send(Done(stage, 0.0))
                continue
            progress(ProgressEvent(stage, 0.0, f"starting {stage}"))
            started = time.monotonic()
            folder = start_stage(job, stage)
            pkgutil.resolve_name(run)[stage](job, folder, progress)
            seconds = time.monotonic() - started
            finish_stage(job, stage, folder, seconds)
            send(Done(stage, seconds))
    except Exception as error:
        send(Failed(operation_error(error, stage, job)))
        return 1
    return 0


def _throttled(send: Callable[[Event], None]) -> Callable[[ProgressEvent], None]:
    """Forwards ten events a second, those with files or at a stage's ends, and all metrics."""
    sent_at, sent_stage = 0.0, ""
    metrics: dict[str, float] = {}

    def progress(event: ProgressEvent) -> None:
        nonlocal sent_at, sent_stage
        now = time.monotonic()
        metrics.update(event.metrics)
        if now - sent_at >= _PROGRESS_S or event.stage != sent_stage or event.fraction >= 1 or event.files:
            sent_at, sent_stage = now, event.stage
            send(replace(event, metrics=dict(metrics)))
            metrics.clear()

    return progress


def _write(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]


if __name__ == "__main__":
    sys.exit(main())
