"""Clock for ages: no jump of the wall clock makes anything old at once.

It goes with the wall clock, but by at most an hour from one look to the next, and not back. A wall clock that is set
forward by a day, or a machine that was off for a week, so ages nothing by more than an hour; where there is something
to age, a worker looks once a minute. How far it has come is kept in the data folder, so that all processes on it, now
and after a restart, have the same time. What is compared with it must have been marked by it.

data folder/.clock   two numbers of 20 digits: this clock's time, and the wall clock's at the last look; microseconds
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
    """The clock of one data folder. Safe from any thread and from several processes."""

    def __init__(self, root: Path, wall: Callable[[], float] = time.time) -> None:
        self._path = root / _NAME
        self._wall = wall

    def now(self) -> float:
        """Seconds since 1970, as this clock counts them."""
        wall = self._wall()
        try:
            handle = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o600)
        except OSError:  # there is no folder yet, or it is read only
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
            # A wall clock that is a little behind is another machine's; one far behind was set back.
            if passed >= _WRITE_EVERY_S or passed < -_LONGEST_STEP_S:
                self._write(handle, now, wall)
            return now
        finally:
            os.close(handle)  # and with it the lock

    def _write(self, handle: int, now: float, wall: float) -> None:
        with suppress(OSError):  # in place: one sector changes at once
            os.pwrite(handle, f"{round(now * 1e6):0{_DIGITS}d}{round(wall * 1e6):0{_DIGITS}d}".encode(), 0)
