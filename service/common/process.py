"""Ties a child process's life to its parent's. Linux only; imports nothing heavy."""

from __future__ import annotations

import ctypes
import os
import signal

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent_pid: int, death_signal: signal.Signals = signal.SIGKILL) -> None:
    """Have the kernel send this process `death_signal` once the thread that started it ends (prctl(2)).

    Call it first thing in the child. Exits at once with status 1 if the parent is gone already: the kernel reports no
    death that came before this call.

    Args:
        parent_pid: process id of the parent, which the parent hands to the child; asking for it in the child would be
            too late.
        death_signal: what the kernel sends.

    Raises:
        OSError: the kernel refuses.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, int(death_signal), 0, 0, 0) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"prctl(PR_SET_PDEATHSIG): {os.strerror(number)}")
    if os.getppid() != parent_pid:
        os._exit(1)
