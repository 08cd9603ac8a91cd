"""The isolated side of `service.capture.isolation`: `python -m fastsplat.service.capture.child TASK FOLDER`."""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import resource
import signal
import sys
from pathlib import Path
from typing import Any

from fastsplat_contract.errors import FastSplatError, ResourceError

_PR_SET_PDEATHSIG = 1
_POLITE = 5


def main(task: str, folder: Path) -> None:
    """Read `request.json`, run the task below its memory limit, write `result.json`."""
    _die_with_parent()
    request: dict[str, Any] = json.loads((folder / "request.json").read_text())
    limit, told_limit, what = int(request.pop("memory_bytes")), request.pop("memory_limit"), request.pop("what")
    _, hard = resource.getrlimit(resource.RLIMIT_AS)  # stays: a task may start a child of its own with another limit
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        result = _run(task, request, folder)
    except FastSplatError as error:
        details = {"message": error.message, "hint": error.hint, "field": error.field, "limit": error.limit}
        result = {"error": {"type": type(error).__name__, **details}}
    except MemoryError:
        details = {
            "message": f"{what} needs more memory than it may have",
            "limit": told_limit,
            "hint": "Send fewer or smaller images, or raise the limit.",
        }
        result = {"error": {"type": ResourceError.__name__, **details}}
    partial = folder / "result.json.partial"
    partial.write_text(json.dumps(result))
    partial.rename(folder / "result.json")


def _run(task: str, request: dict[str, Any], folder: Path) -> dict[str, Any]:
    # Imported only now, below the memory limit, and only what the task needs.
    if task == "admit":
        os.nice(_POLITE)  # its parent answers questions meanwhile
        admission = importlib.import_module("fastsplat.service.capture.admission")
        return dict(admission.run(request))
    if task in ("probe", "frames"):
        video = importlib.import_module("fastsplat.service.capture.video")
        result: dict[str, Any] = video.probe(request) if task == "probe" else video.extract(request, _tell)
    else:
        sfm = importlib.import_module("fastsplat.service.capture.sfm")
        result = getattr(sfm, task)(request, folder, _tell)
    return result


def _tell(fraction: float, message: str) -> None:
    _PROGRESS.write(json.dumps([fraction, message]).encode() + b"\n")
    _PROGRESS.flush()


def _die_with_parent() -> None:
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


if __name__ == "__main__":
    # Libraries print to descriptor 1: progress gets a descriptor of its own, theirs goes to the log.
    _PROGRESS = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    main(sys.argv[1], Path(sys.argv[2]))
