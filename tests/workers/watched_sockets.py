"""Watches what Python processes connect or send to, and which names of hosts they look up."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

_HOOK = """
import os, sys

def note(event, arguments):
    if event in ("socket.connect", "socket.sendto", "socket.sendmsg") and isinstance(arguments[1], tuple):
        said = f"{event} {arguments[1]}"
    elif event in ("socket.getaddrinfo", "socket.gethostbyname"):
        said = f"{event} {arguments[0]}"
    else:
        return
    with open(os.environ["WATCHED_SOCKETS"], "a") as file:
        file.write(f"{os.getpid()} {said}\\n")

sys.addaudithook(note)
"""


def watching(folder: Path, environment: Mapping[str, str]) -> dict[str, str]:
    """An environment whose Python processes note each connection in `seen`, but for file-system sockets."""
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(_HOOK)
    path = os.pathsep.join([str(folder), *filter(None, [environment.get("PYTHONPATH", "")])])
    return {**environment, "PYTHONPATH": path, "WATCHED_SOCKETS": str(folder / "seen")}


def seen(folder: Path) -> list[str]:
    """What was noted: the process's id, the event, and where to."""
    file = folder / "seen"
    return file.read_text().splitlines() if file.exists() else []
