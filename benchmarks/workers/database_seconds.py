"""Seconds of processors that processes have taken."""

from __future__ import annotations

import os
from pathlib import Path

from tests.postgres import PostgresServer

_CLOCK = os.sysconf("SC_CLK_TCK")


def cpu_seconds(server: PostgresServer) -> float:
    """Seconds of processors that all processes of a server took so far."""
    assert server._process is not None
    return process_seconds(server._process.pid)


def process_seconds(main_id: int) -> float:
    """Seconds of processors that a process and its children took so far."""
    children = Path(f"/proc/{main_id}/task/{main_id}/children").read_text().split()
    fields = [Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split() for pid in (str(main_id), *children)]
    # utime and stime of each; of the first also what its children took that have ended (proc(5)).
    ticks = sum(int(field) for stat in fields for field in stat[11:13]) + sum(map(int, fields[0][13:15]))
    return ticks / _CLOCK
