"""`admit_upload` in a child process: what dies of a hostile file is one request, not the service."""

from __future__ import annotations

import importlib
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fastsplat.service.capture.isolation import run_isolated
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.types import AdmittedUpload
from fastsplat.service.common.cancellation import check_cancelled


def admit_isolated(upload_dir: Path, settings: CaptureSettings) -> AdmittedUpload:
    """As `admit_upload`, within `admit_memory_bytes` and `admit_seconds`; stops when its caller goes away.

    Raises:
        ResourceError: it hit one of its limits, or crashed.
        CancelledError: nobody waits any more.
        FastSplatError: as `admit_upload`.
    """
    request = {"upload": str(upload_dir), "settings": settings.model_dump(mode="json")}
    with tempfile.TemporaryDirectory(prefix="fastsplat-") as folder:
        result = run_isolated("admit", request, Path(folder), settings, lambda fraction, message: check_cancelled())
    return AdmittedUpload(
        Path(result["folder"]),
        result["source"],
        result["images"],
        result["has_labels"],
        tuple(result["warnings"]),
    )


def run(request: dict[str, Any]) -> dict[str, Any]:
    """In the child: admit, and tell the result as JSON."""
    upload = importlib.import_module("fastsplat.service.capture.upload")  # below the memory limit, and only here
    admitted = upload.admit_upload(Path(request["upload"]), CaptureSettings(**request["settings"]))
    return {**asdict(admitted), "folder": str(admitted.folder)}
