"""Metrics of jobs and open scenes, for one server process."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from fastsplat.service.store.queue.claims import JobQueue

_OVERLAP_S = 120.0  # clocks of other machines may be behind


class ServiceMetrics:
    """Job counts by state, and stage durations of jobs that ended since construction."""

    def __init__(self, rows: JobQueue, open_scenes: Callable[[], int]) -> None:
        self.open_scenes = open_scenes
        self._rows = rows
        self._lock = threading.Lock()
        self._mark = time.time()
        self._seen = {operation_id: at for operation_id, at, _ in self._ended()}

    def jobs(self) -> Mapping[str, int]:
        """Number of jobs by state."""
        return self._rows.jobs_by_state()

    def newly_ended_stages(self) -> Sequence[tuple[str, float]]:
        """(stage, seconds) of jobs that ended since the last call, each reported once."""
        with self._lock:
            now = time.time()
            stages: list[tuple[str, float]] = []
            for operation_id, at, done in self._ended():
                if operation_id not in self._seen:
                    self._seen[operation_id] = at
                    stages += [(str(stage["stage"]), float(stage["seconds"])) for stage in done]
            self._mark = now
            self._seen = {name: at for name, at in self._seen.items() if at > now - 2 * _OVERLAP_S}
            return stages

    def _ended(self) -> Sequence[tuple[str, float, Sequence[Mapping[str, Any]]]]:
        return self._rows.ended_since(self._mark - _OVERLAP_S)
