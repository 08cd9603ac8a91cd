"""Process lifetimes, priorities and memory, without heavy imports."""

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
"""Environment variable with the parent's process id; the child dies with that parent."""
_PR_SET_PDEATHSIG = 1
_NICEST = 19
_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")

_log = logging.getLogger(__name__)


@contextmanager
def loading_modules() -> Iterator[None]:
    """Disables garbage collection while modules load, then freezes them.

    Modules contain no garbage, and scanning them takes a sixth of their loading time.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def die_with_parent(parent_pid: int, death_signal: signal.Signals = signal.SIGKILL) -> None:
    """Has the kernel send `death_signal` when the starting thread ends (prctl(2)).

    Call it first in the child; exits with status 1 if the parent is gone already. The parent passes its id, since
    `getppid` in the child could be too late.

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
    """Applies `die_with_parent` if `PARENT_VARIABLE` is set, and unsets it."""
    if parent := os.environ.pop(PARENT_VARIABLE, ""):
        die_with_parent(int(parent), death_signal)


def yield_to_others(niceness: int) -> None:
    """Raises this process's niceness by 0 to 19, before it starts threads.

    A session leader also raises its autogroup's niceness (sched(7)).
    """
    if niceness:
        os.nice(niceness)
        if os.getsid(0) == os.getpid():
            with suppress(OSError):  # no autogroups, or forbidden by a sandbox
                Path("/proc/self/autogroup").write_text(str(min(_NICEST, niceness)))


def lower_priority(niceness: int) -> None:
    """Raises the niceness of this thread and all it starts later; Linux only."""
    if sys.platform != "linux":
        return
    thread = threading.get_native_id()
    try:
        os.setpriority(os.PRIO_PROCESS, thread, min(_NICEST, os.getpriority(os.PRIO_PROCESS, thread) + niceness))
    except OSError as error:  # a sandbox that forbids it
        _log.warning("calls in the background run at the priority of all others: %s", error.strerror)


def machine_bytes() -> int:
    """Memory of the machine, or of this process's control group if less, in bytes."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    for path in _LIMITS:
        try:
            limits.append(int(Path(path).read_text()))
        except (OSError, ValueError):  # no such hierarchy, or "max"
            continue
    return min(limits)
