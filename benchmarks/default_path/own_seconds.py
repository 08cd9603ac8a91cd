"""Where the seconds go: which functions of this repository a thread is in, looked at two hundred times a second."""

from __future__ import annotations

import sys
import threading
import time
from collections import defaultdict
from types import FrameType, TracebackType
from typing import Self

from benchmarks.provenance import ROOT

_EVERY_S = 0.005
_LEAST_SHARE = 0.005


class OwnSeconds:
    """Counts, while it is entered, the seconds of the thread that entered it by function: what a function calls of
    other programs, a kernel, a model, a library, is its own."""

    def __init__(self) -> None:
        self._seconds: defaultdict[str, float] = defaultdict(float)
        self._over = threading.Event()
        self._watcher = threading.Thread(target=self._watch, args=(threading.get_ident(),), daemon=True)

    def __enter__(self) -> Self:
        self._watcher.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._over.set()
        self._watcher.join()

    def rows(self) -> dict[str, float]:
        """Seconds by file and function, most first; those below a two-hundredth of all are left out."""
        total = sum(self._seconds.values())
        ordered = sorted(self._seconds.items(), key=lambda row: -row[1])
        return {name: round(seconds, 1) for name, seconds in ordered if seconds >= _LEAST_SHARE * total}

    def _watch(self, thread: int) -> None:
        before = time.monotonic()
        while not self._over.wait(_EVERY_S):
            name, now = _innermost_function(sys._current_frames().get(thread)), time.monotonic()
            self._seconds[name] += now - before
            before = now


def _innermost_function(frame: FrameType | None) -> str:
    """The innermost function of this repository."""
    while frame is not None:
        file = frame.f_code.co_filename
        if file.startswith(f"{ROOT}/") and "site-packages" not in file:
            return f"{file.removeprefix(f'{ROOT}/').removeprefix('fastsplat/')} {frame.f_code.co_qualname}"
        frame = frame.f_back
    return "elsewhere"
