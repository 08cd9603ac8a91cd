"""Process lifetime tied to the parent's, and priorities of processes and threads. Imports nothing heavy."""

from __future__ import annotations

import ctypes
import gc
import logging
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PARENT_VARIABLE = "FASTSPLAT_PARENT_PID"
"""Environment variable that names the parent whose end is a child's end too."""
_PR_SET_PDEATHSIG = 1
_NICEST = 19

_log = logging.getLogger(__name__)


@contextmanager
def loading_modules() -> Iterator[None]:
    """Collect no garbage meanwhile, and look for none among what there is afterwards: of modules none ever is, and
    going through them takes a sixth of the seconds that they take to load."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def die_with_parent(parent_pid: int, death_signal: signal.Signals = signal.SIGKILL) -> None:
    """Have the kernel send this process `death_signal` once the thread that started it ends (prctl(2)). To be called
    first in the child; exits at once with status 1 if the parent is gone already.

    Args:
        parent_pid: process id of the parent, which the parent hands to the child; asking for it in the child would be
            too late.

    Raises:
        OSError: the kernel refuses.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, int(death_signal), 0, 0, 0) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"prctl(PR_SET_PDEATHSIG): {os.strerror(number)}")
    if os.getppid() != parent_pid:
        os._exit(1)


def die_with_named_parent(death_signal: signal.Signals = signal.SIGKILL) -> None:
    """`die_with_parent` where `PARENT_VARIABLE` names one, which is then no more in the environment."""
    if parent := os.environ.pop(PARENT_VARIABLE, ""):
        die_with_parent(int(parent), death_signal)


def yield_to_others(niceness: int) -> None:
    """Make this process so much nicer to others than it is, before it starts threads; and its session, where it leads
    one (sched(7), autogroup).

    Args:
        niceness: 0 to 19.
    """
    if niceness:
        os.nice(niceness)
        if os.getsid(0) == os.getpid():
            with suppress(OSError):  # a kernel without, or a sandbox that forbids it
                Path("/proc/self/autogroup").write_text(str(min(_NICEST, niceness)))


def lower_priority(niceness: int) -> None:
    """Make this thread, and all that it starts from now on, so much nicer than it is; does nothing but on Linux, where
    niceness is a thread's.
    """
    if sys.platform != "linux":
        return
    thread = threading.get_native_id()
    try:
        os.setpriority(os.PRIO_PROCESS, thread, min(_NICEST, os.getpriority(os.PRIO_PROCESS, thread) + niceness))
    except OSError as error:  # a sandbox that forbids it
        _log.warning("calls in the background run at the priority of all others: %s", error.strerror)
