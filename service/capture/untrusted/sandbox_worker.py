"""Child side of `untrusted.sandbox`: python -m ….sandbox_worker TASK FOLDER PARENT_PID."""

from __future__ import annotations

import errno
import importlib
import json
import os
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fastsplat.service.capture.untrusted.confinement import ResourceLimits, confine
from fastsplat.service.common.process import die_with_parent
from fastsplat_contract.errors import FastSplatError, ResourceError

_NICENESS = 5
_READ = ("video", "image_folder", "mask_folder")  # and all of "roots"
_WRITTEN = ("upload", "folder")
"""Fields of a request with paths that a task may read, and change."""
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def main(task: str, folder: Path, parent_pid: int) -> None:
    """Runs the task of `request.json` within its limits and folders and writes `result.json`."""
    die_with_parent(parent_pid)
    request: dict[str, Any] = json.loads((folder / "request.json").read_text())
    limits, memory_limit = ResourceLimits(**request.pop("limits")), request.pop("memory_limit")
    description = request.pop("description")
    readable = [
        Path(path) for path in (*(request[name] for name in _READ if name in request), *request.get("roots", ()))
    ]
    confine(limits, readable, [folder, *(Path(request[name]) for name in _WRITTEN if name in request)])
    die_with_parent(parent_pid)  # again, as the kernel resets it when credentials change

    def error_of(error: Exception) -> dict[str, Any] | None:
        return _error_to_json(error, description, memory_limit)

    if task == "decode":
        decoding = importlib.import_module("fastsplat.service.capture.untrusted.image_decoding")
        decoding.decode_requests(request, _ANSWERS, error_of)
        return
    try:
        result = _run(task, request, folder)
    except (FastSplatError, MemoryError, OSError) as error:
        details = error_of(error)
        if details is None:
            raise
        result = {"error": details}
    partial = folder / "result.json.partial"
    partial.write_text(json.dumps(result))
    partial.rename(folder / "result.json")


def _error_to_json(error: Exception, description: str, memory_limit: str) -> dict[str, Any] | None:
    if isinstance(error, FastSplatError):
        details = {"message": error.message, "hint": error.hint, "field": error.field, "limit": error.limit}
        return {"type": type(error).__name__, **details}
    if isinstance(error, MemoryError):
        return {
            "type": ResourceError.__name__,
            "message": f"{description} needs more memory than its limit",
            "limit": memory_limit,
            "hint": "Send fewer or smaller images, or raise the limit.",
        }
    if isinstance(error, OSError) and error.errno in _NO_ROOM:
        return {
            "type": ResourceError.__name__,
            "message": f"{description} needs more room than is left on the server's disk, or than one file may have",
            "field": "data_dir",
            "hint": "Send fewer images, or free space in the server's data folder.",
        }
    return None


def _run(task: str, request: dict[str, Any], folder: Path) -> dict[str, Any]:
    # Imported only now, under the memory limit, and only what the task needs.
    if task == "validate":
        os.nice(_NICENESS)  # its parent is serving meanwhile
        settings = importlib.import_module("fastsplat.service.capture.capture_settings")
        validation = importlib.import_module("fastsplat.service.capture.uploads.upload_validation")
        limits = settings.CaptureSettings(**request["settings"])
        validated = validation.validate_upload(Path(request["upload"]), limits, request.get("strict", False))
        return {**asdict(validated), "folder": str(validated.folder)}
    if task in ("probe", "frames"):
        video = importlib.import_module("fastsplat.service.capture.photos.video")
        result: dict[str, Any] = video.probe(request) if task == "probe" else video.extract(request, _report)
    else:
        module = "pose_refinement" if task == "refine" else "reconstruction"
        sfm = importlib.import_module(f"fastsplat.service.capture.sfm.{module}")
        result = getattr(sfm, task)(request, folder, _report)
    return result


def _report(fraction: float, message: str) -> None:
    _ANSWERS.write(json.dumps([fraction, message]).encode() + b"\n")
    _ANSWERS.flush()


if __name__ == "__main__":
    # Libraries print to descriptor 1, so answers get their own and descriptor 1 goes to the log.
    _ANSWERS = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]))
