"""The child's side of `service.capture.sandbox`.

Run as `python -m fastsplat.service.capture.sandbox_worker TASK FOLDER PARENT_PID`.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fastsplat.service.common.process import die_with_parent
from fastsplat_contract.errors import FastSplatError, ResourceError

_NICENESS = 5


def main(task: str, folder: Path, parent_pid: int) -> None:
    """Read `request.json`, run the task below its memory limit, write `result.json`."""
    die_with_parent(parent_pid)
    request: dict[str, Any] = json.loads((folder / "request.json").read_text())
    memory_bytes, memory_limit = int(request.pop("memory_bytes")), request.pop("memory_limit")
    description = request.pop("description")
    _, hard = resource.getrlimit(resource.RLIMIT_AS)  # stays: a task may start a child of its own with another limit
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        result = _run(task, request, folder)
    except FastSplatError as error:
        details = {"message": error.message, "hint": error.hint, "field": error.field, "limit": error.limit}
        result = {"error": {"type": type(error).__name__, **details}}
    except MemoryError:
        details = {
            "message": f"{description} needs more memory than its limit",
            "limit": memory_limit,
            "hint": "Send fewer or smaller images, or raise the limit.",
        }
        result = {"error": {"type": ResourceError.__name__, **details}}
    partial = folder / "result.json.partial"
    partial.write_text(json.dumps(result))
    partial.rename(folder / "result.json")


def _run(task: str, request: dict[str, Any], folder: Path) -> dict[str, Any]:
    # Imported only now, below the memory limit, and only what the task needs.
    if task == "validate":
        os.nice(_NICENESS)  # its parent answers questions meanwhile
        settings = importlib.import_module("fastsplat.service.capture.settings")
        validation = importlib.import_module("fastsplat.service.capture.upload_validation")
        validated = validation.validate_upload(Path(request["upload"]), settings.CaptureSettings(**request["settings"]))
        return {**asdict(validated), "folder": str(validated.folder)}
    if task in ("probe", "frames"):
        video = importlib.import_module("fastsplat.service.capture.video")
        result: dict[str, Any] = video.probe(request) if task == "probe" else video.extract(request, _report)
    else:
        sfm = importlib.import_module("fastsplat.service.capture.sfm")
        result = getattr(sfm, task)(request, folder, _report)
    return result


def _report(fraction: float, message: str) -> None:
    _PROGRESS.write(json.dumps([fraction, message]).encode() + b"\n")
    _PROGRESS.flush()


if __name__ == "__main__":
    # Libraries print to descriptor 1: progress gets a descriptor of its own, theirs goes to the log.
    _PROGRESS = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]))
