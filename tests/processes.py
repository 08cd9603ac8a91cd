"""Processes by their environment, and whether one runs."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest


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


def printed_with_mount(mount: str, code: str, *arguments: Path) -> str:
    """What Python code prints with a disk of its own; skips the test where none can be mounted."""
    run = f'{mount} && exec {sys.executable} -c "$@"'
    command = ["unshare", "--mount", "--map-root-user", "sh", "-c", run, "sh"]
    if shutil.which("unshare") is None or subprocess.run([*command, ""], check=False, capture_output=True).returncode:
        pytest.skip("no disk can be mounted here")
    done = subprocess.run([*command, code, *arguments], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout
