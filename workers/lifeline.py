"""Processes that do not outlive the one that started them. Imports nothing heavy."""

from __future__ import annotations

import ctypes
import os
import signal

PARENT_VARIABLE = "FASTSPLAT_PARENT_PID"
"""Tells a child whose life it shares."""
_PR_SET_PDEATHSIG = 1
_MOST_DESCRIPTORS = 1024


def die_with_parent(parent_pid: int, how: signal.Signals = signal.SIGKILL) -> None:
    """Have the kernel send `how` to this process once the thread that started it ends.

    Exits at once if the parent is gone already: the kernel tells nothing of deaths before this call.
    """
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, int(how), 0, 0, 0)
    if os.getppid() != parent_pid:
        os._exit(1)


def guard_group() -> None:
    """Fork a guard that kills this process group, grandchildren too, once nobody holds the other end of stdin.

    The kernel's own signal reaches one process only, and a Python handler would wait for native code to return.
    """
    if os.fork():
        return
    os.closerange(1, _MOST_DESCRIPTORS)  # or the readers of our pipes would never see their end
    try:
        while os.read(0, 1024):
            pass
    finally:
        os.killpg(0, signal.SIGKILL)
