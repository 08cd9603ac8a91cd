"""Queue positions and expected starts of waiting jobs."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping, Sequence
from heapq import heapify, heapreplace

from fastsplat.service.application.jobs.stored import Ahead
from fastsplat.service.store.rows.records import PREDICTED_S, SECONDS_LEFT, OperationRecord
from fastsplat.service.store.store import Store

_FRESH_S = 1.0
"""Age up to which a forecast serves again: each watcher of a waiting job asks several times a second."""


class QueueTimes:
    """Forecasts the queue of all projects, shared by all callers. Thread-safe."""

    def __init__(self, store: Store, timeout_s: float) -> None:
        self._store, self._timeout_s = store, timeout_s
        self._lock = threading.Lock()
        self._ahead: Mapping[str, Ahead] = {}
        self._read_at = -math.inf

    def ahead(self, records: Sequence[OperationRecord]) -> Mapping[str, Ahead]:
        """Jobs ahead of waiting ones among these, and their expected starts; empty if none waits."""
        waiting = {record.id for record in records if record.state == "QUEUED"}
        if not waiting:
            return {}
        with self._lock:
            if time.monotonic() - self._read_at > _FRESH_S or not waiting <= self._ahead.keys():
                self._ahead, self._read_at = self._forecast(), time.monotonic()
            return self._ahead

    def _forecast(self) -> Mapping[str, Ahead]:
        heard_since, under_way = time.time() - self._timeout_s, self._store.jobs.under_way()
        ends = [_seconds_of(job, heard_since) for job in under_way]
        ends += [0.0] * (self._store.workers.alive(self._timeout_s) - len(ends))
        heapify(ends := ends or [math.inf])
        ahead, number = {}, sum(not job.cancel_requested for job in under_way)
        for job in self._store.jobs.in_turn():
            ahead[job.id] = number, ends[0]
            number += not job.cancel_requested
            heapreplace(ends, ends[0] + _seconds_of(job, heard_since))  # the first free worker takes it
        return ahead


def _seconds_of(job: OperationRecord, heard_since: float) -> float:
    """Remaining seconds of a job, as predicted or last reported; infinite: unknown."""
    if job.cancel_requested:
        return 0.0
    if job.state == "QUEUED":
        return float(job.options.get(PREDICTED_S, math.inf))
    left = job.stages[-1]["metrics"].get(SECONDS_LEFT, -1) if job.stages and job.updated_at >= heard_since else -1
    return float(left) if left >= 0 else math.inf
