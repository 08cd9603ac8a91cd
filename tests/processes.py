"""Processes by their environment, and whether one runs."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest


def process_file(path: Path) -> bytes:
    """The contents of a file of /proc, none once its process has ended."""
    try:
        return path.read_bytes()
    except OSError:
        return b""


def processes_with(variable: str, folder: Path) -> list[str]:
    """Ids of the processes in whose environment a variable names a folder."""
    mark, paths = f"{variable}={folder.resolve()}".encode(), Path("/proc").glob("[0-9]*/environ")
    return [path.parent.name for path in paths if mark in process_file(path).split(b"\0")]


def is_alive(pid: int) -> bool:
    """Whether a process runs (a zombie does not)."""
    return process_file(Path(f"/proc/{pid}/stat")).rpartition(b")")[2][1:2] not in (b"", b"Z", b"X")


def printed_with_mount(mount: str, code: str, *arguments: Path) -> str:
    """What Python code prints with a disk of its own; skips the test where none can be mounted."""
    run = f'{mount} && exec {sys.executable} -c "$@"'
    command = ["unshare", "--mount", "--map-root-user", "sh", "-c", run, "sh"]
    if shutil.which("unshare") is None or subprocess.run([*command, ""], check=False, capture_output=True).returncode:
        pytest.skip("no disk can be mounted here")
    done = subprocess.run([*command, code, *arguments], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout
