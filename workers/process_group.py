"""Process groups that end with their parent, and what is known of a process by its id. Imports nothing heavy."""

from __future__ import annotations

import os
import signal
import socket
from pathlib import Path

_MOST_DESCRIPTORS = 1024
_START_TIME = 18  # field 22 of /proc/PID/stat, counted from the one after the state
_CLOCK_SLACK_S = 2.0


def fork_group_guard() -> None:
    """Fork a process that kills this process group, grandchildren included, once the other end of stdin is closed.

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


def machine_id() -> str:
    """Identity of one boot of one machine and one container of it: within it, a process id names one process."""
    boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    return f"{socket.gethostname()} {boot} {os.readlink('/proc/self/ns/pid')}"


def process_state(pid: int, before: float) -> str:
    """State letter of a process in this `machine_id`: "T" is stopped, as by SIGSTOP; "" has ended, "?" is hidden.

    Args:
        pid: its id.
        before: seconds after the boot; a process that started later is another one with the same id. (A time of day
            would not do: that clock jumps.)
    """
    try:
        state, *numbers = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        return "?" if _exists(pid) else ""
    started_at = int(numbers[_START_TIME]) / os.sysconf("SC_CLK_TCK")
    return "" if state in "ZX" or started_at > before + _CLOCK_SLACK_S else state


def _exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # another user's, whom /proc may hide
        pass
    return True
