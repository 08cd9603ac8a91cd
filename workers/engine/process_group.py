"""Process groups that end with their parent, and process states; no heavy imports."""

from __future__ import annotations

import os
import signal
import socket
from pathlib import Path

_MOST_DESCRIPTORS = 1024
_START_TIME = 18  # field 22 of /proc/PID/stat, counted from the one after the state
_CLOCK_SLACK_S = 2.0


def fork_group_guard() -> None:
    """Forks a guard that kills this process group once stdin's other end closes.

    The kernel's own signal reaches a single process, and a Python handler would wait for native code to return.
    """
    if os.fork():
        return
    os.closerange(1, _MOST_DESCRIPTORS)  # otherwise readers of our pipes would never see EOF
    try:
        while os.read(0, 1024):
            pass
    finally:
        os.killpg(0, signal.SIGKILL)


def machine_id() -> str:
    """Identifies a machine's boot and container, within which process ids are unique."""
    boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    return f"{socket.gethostname()} {boot} {os.readlink('/proc/self/ns/pid')}"


def process_state(pid: int, before: float) -> str:
    """State letter of a process of this `machine_id`: "T" stopped, "" ended, "?" hidden.

    `before` is seconds since boot (the time of day jumps); a process started later only reuses the id.
    """
    try:
        state, *numbers = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return ""
        except PermissionError:  # another user's, possibly hidden in /proc
            pass
        return "?"
    started_at = int(numbers[_START_TIME]) / os.sysconf("SC_CLK_TCK")
    return "" if state in "ZX" or started_at > before + _CLOCK_SLACK_S else state
