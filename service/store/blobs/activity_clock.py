"""A clock for ages, robust to jumps of the wall clock.

It follows the wall clock by at most an hour from one reading to the next, and never backwards; workers read it once a
minute. So a wall clock set forward, or a machine that was off for a week, ages nothing by more than an hour. All
processes share its state in the data folder. Only times marked by this clock may be compared with it.

data folder/.clock   two numbers of 20 digits, in microseconds: this clock's time, and the wall clock's at that reading
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

_NAME = ".clock"
_LONGEST_STEP_S = 3600.0
_WRITE_EVERY_S = 30.0
_DIGITS = 20


class ActivityClock:
    """The clock of one data folder; safe from any thread and from several processes."""

    def __init__(self, root: Path, wall: Callable[[], float] = time.time) -> None:
        self._path = root / _NAME
        self._wall = wall

    def now(self) -> float:
        """Returns seconds since 1970 by this clock."""
        wall = self._wall()
        try:
            handle = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600)
        except OSError:  # no folder yet, or a read-only one
            return wall
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
            content = os.pread(handle, 2 * _DIGITS, 0)
            try:
                last, last_wall = int(content[:_DIGITS]) / 1e6, int(content[_DIGITS:]) / 1e6
            except ValueError:  # new
                self._write(handle, wall, wall)
                return wall
            passed = wall - last_wall
            now = last + min(max(passed, 0.0), _LONGEST_STEP_S)
            # A wall clock slightly behind is another machine's; one far behind was set back.
            if passed >= _WRITE_EVERY_S or passed < -_LONGEST_STEP_S:
                self._write(handle, now, wall)
            return now
        finally:
            os.close(handle)  # releases the lock

    def _write(self, handle: int, now: float, wall: float) -> None:
        with suppress(OSError):  # in place: a sector is written atomically
            os.pwrite(handle, f"{round(now * 1e6):0{_DIGITS}d}{round(wall * 1e6):0{_DIGITS}d}".encode(), 0)
