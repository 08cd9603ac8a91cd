"""Processes by their environment, and whether one runs."""

from __future__ import annotations

from pathlib import Path


def processes_with(variable: str, folder: Path) -> list[str]:
    """Ids of the processes in whose environment a variable names a folder."""
    mark, found = f"{variable}={folder.resolve()}".encode(), []
    for environment in Path("/proc").glob("[0-9]*/environ"):
        try:
            if mark in environment.read_bytes().split(b"\0"):
                found.append(environment.parent.name)
        except OSError:
            continue
    return found


def is_alive(pid: int) -> bool:
    """Whether a process runs (a zombie does not)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] not in "ZX"
    except OSError:
        return False
