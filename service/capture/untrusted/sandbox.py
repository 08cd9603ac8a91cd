"""Runs parsers of untrusted data in confined child processes without environment, isolating their crashes."""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.capture.formats.upload_manifest import VALIDATED
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat_contract import errors
from fastsplat_contract.errors import FastSplatError, ReconstructionError, ResourceError

Task = Literal["validate", "probe", "frames", "decode", "reconstruct", "triangulate", "refine"]
Listener = Callable[[float, str], None]
"""Receives the share of the task that is done, and a message; may raise."""

_ENVIRONMENT = {
    "OMP_WAIT_POLICY": "passive",
    "OPENBLAS_NUM_THREADS": "1",  # numpy's products are small, and its threads would spin beside COLMAP's
    # Excludes playlists and containers that refer to other files.
    "OPENCV_FFMPEG_CAPTURE_OPTIONS": "protocol_whitelist;file|format_whitelist;mov,avi,matroska",
    "LC_ALL": "C.UTF-8",
    "PYTHONUTF8": "1",
    "PATH": "/usr/bin:/bin",
}
_PASSED_ON = ("OMP_NUM_THREADS", "LD_LIBRARY_PATH")
_WORKER = "fastsplat.service.capture.untrusted.sandbox_worker"
_HEARTBEAT_S = 2.0
_OUT_OF_MEMORY_SIGNS = ("bad_alloc", "cannot allocate", "out of memory", "memoryerror", "failed to map")
_TRACEBACK_LINES = 60  # a library that fails to load for lack of memory says so at the top of its traceback
_DESCRIPTIONS: dict[Task, str] = {
    "validate": "checking the upload",
    "probe": "checking the video",
    "frames": "reading the video",
    "decode": "decoding the images",
    "reconstruct": "structure from motion",
    "triangulate": "triangulation",
    "refine": "refining the poses",
}


@dataclass(frozen=True)
class _Limits:
    """Limits of a task, and the settings that define them."""

    memory_bytes: int
    memory_setting: str
    seconds: int
    seconds_setting: str

    @property
    def cpu_seconds(self) -> int:
        return (self.seconds + 1) * (os.cpu_count() or 1)

    @property
    def memory(self) -> str:
        return f"{self.memory_bytes} bytes" + _named(self.memory_setting)

    @property
    def time(self) -> str:
        return f"{self.seconds} s" + _named(self.seconds_setting)


def validate_in_sandbox(upload_dir: Path, settings: CaptureSettings, strict: bool = False) -> ValidatedUpload:
    """Runs `validate_upload` in a child process; ends early when the caller is cancelled.

    Raises:
        ResourceError: it exceeded `validation_memory_bytes` or `validation_seconds`, or crashed.
        CancelledError: the caller was cancelled.
        FastSplatError: as `validate_upload`.
    """
    request = {"upload": str(upload_dir), "settings": settings.model_dump(mode="json"), "strict": strict}
    # Beside the upload, so that it is removed with it if this process is killed.
    with tempfile.TemporaryDirectory(prefix=".validation-", dir=upload_dir.parent) as folder:
        result = run_sandboxed("validate", request, Path(folder), settings, lambda fraction, message: check_cancelled())
    return ValidatedUpload(
        upload_dir / VALIDATED,
        result["source"],
        result["images"],
        result["has_labels"],
        tuple(result["warnings"]),
        result["gaussians"],
        result["left_out"],
    )


def run_sandboxed(
    task: Task, request: dict[str, Any], folder: Path, settings: CaptureSettings, listen: Listener
) -> dict[str, Any]:
    """Runs a task of `sandbox_worker` in its own empty folder; returns its result.

    Raises:
        FastSplatError: the typed error that the task raised.
        ResourceError: it exceeded its memory or time limit, or crashed, as C++ does without memory.
        ReconstructionError: the child failed in another way; a RuntimeError for "validate".
        CancelledError: whatever `listen` raised, after the child has ended.
    """
    limits = _limits(task, settings)
    process = start_sandboxed(task, request, folder, settings)
    try:
        _follow(process, task, limits, listen)
        status = process.wait()
    finally:
        kill_sandboxed(process)
    return _result(task, status, folder, limits)


def start_sandboxed(
    task: Task, request: dict[str, Any], folder: Path, settings: CaptureSettings
) -> subprocess.Popen[bytes]:
    """Starts a task of `sandbox_worker` in `folder`, with pipes, until `kill_sandboxed`."""
    limits = _limits(task, settings)
    description = {
        "limits": {
            "memory_bytes": limits.memory_bytes,
            "cpu_seconds": limits.cpu_seconds,
            "file_bytes": settings.max_unpacked_bytes,
        },
        "memory_limit": limits.memory,
        "description": _DESCRIPTIONS[task],
    }
    (folder / "request.json").write_text(json.dumps({**request, **description}))
    with (folder / "log.txt").open("wb") as log:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", _WORKER, task, str(folder), str(os.getpid())],
            stdin=subprocess.PIPE if task == "decode" else subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=log,
            cwd=folder,
            env=_environment(folder),
            start_new_session=True,
        )


def kill_sandboxed(process: subprocess.Popen[bytes]) -> int:
    """Kills the child and its children, which may outlive its crash; returns its exit status."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(BrokenPipeError):
                pipe.close()
    return process.wait()


def decoder_error(status: int, folder: Path, settings: CaptureSettings) -> FastSplatError:
    """Makes the error of a decoding child that ended early with `status`."""
    return _crash("decode", status, folder, _limits("decode", settings))


def error_from_json(details: dict[str, Any]) -> FastSplatError:
    """Restores a typed error from a child."""
    kind = getattr(errors, details.pop("type"))
    assert issubclass(kind, FastSplatError)
    error: FastSplatError = kind(details.pop("message"), **details)
    return error


def _environment(folder: Path) -> dict[str, str]:
    passed_on = {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
    return {**passed_on, **_ENVIRONMENT, "HOME": str(folder), "TMPDIR": str(folder)}


def _named(setting: str) -> str:
    return f" ({setting})" if setting else ""


def _limits(task: Task, settings: CaptureSettings) -> _Limits:
    if task in ("validate", "probe"):
        return _Limits(settings.validation_memory_bytes, "", settings.validation_seconds, "")
    if task == "decode":  # all images of an upload; each alone has validation_seconds
        return _Limits(settings.validation_memory_bytes, "", settings.sfm_seconds, "FASTSPLAT_CAPTURE__SFM_SECONDS")
    return _Limits(
        settings.sfm_memory_bytes,
        "FASTSPLAT_CAPTURE__SFM_MEMORY_BYTES",
        settings.sfm_seconds,
        "FASTSPLAT_CAPTURE__SFM_SECONDS",
    )


def _follow(process: subprocess.Popen[bytes], task: Task, limits: _Limits, listen: Listener) -> None:
    """Reports progress until output closes; repeats the last while silent, to allow cancelling."""
    assert process.stdout is not None
    deadline = time.monotonic() + limits.seconds
    descriptor = process.stdout.fileno()
    buffer, last = b"", (0.0, "starting")
    with selectors.DefaultSelector() as selector:
        selector.register(descriptor, selectors.EVENT_READ)
        while True:
            if time.monotonic() > deadline:
                raise _took_too_long(task, limits)
            if selector.select(_HEARTBEAT_S):
                chunk = os.read(descriptor, 1 << 16)
                if not chunk:
                    return
                *lines, buffer = (buffer + chunk).split(b"\n")
                for line in lines:
                    fraction, message = json.loads(line)
                    last = (float(fraction), str(message))
                    listen(*last)
            else:
                listen(*last)


def _took_too_long(task: Task, limits: _Limits) -> ResourceError:
    return ResourceError(f"{_DESCRIPTIONS[task]} took too long", limit=limits.time, hint="Send fewer images.")


def _result(task: Task, status: int, folder: Path, limits: _Limits) -> dict[str, Any]:
    path = folder / "result.json"
    if status == 0 and path.is_file():
        result: dict[str, Any] = json.loads(path.read_text())
        if "error" not in result:
            return result
        raise error_from_json(result["error"])
    error = _crash(task, status, folder, limits)
    if task == "validate" and isinstance(error, ReconstructionError):
        raise RuntimeError(f"the process that checks uploads ended with status {status}: {error.message}")
    raise error


def _crash(task: Task, status: int, folder: Path, limits: _Limits) -> FastSplatError:
    if status == -signal.SIGXCPU:
        return _took_too_long(task, limits)
    log = (folder / "log.txt").read_text(errors="replace").strip().splitlines()
    if status < 0 or any(sign in " ".join(log[-_TRACEBACK_LINES:]).lower() for sign in _OUT_OF_MEMORY_SIGNS):
        # C++ without memory does not always say so: some of it writes through the null pointer.
        return ResourceError(
            f"{_DESCRIPTIONS[task]} ended by {f'signal {-status}' if status < 0 else 'an error'}, "
            "as it does when it runs out of memory",
            limit=limits.memory,
            hint="Send fewer or smaller images, or raise the limit.",
        )
    return ReconstructionError(
        f"{_DESCRIPTIONS[task]} ended with status {status}: {log[-1][:300] if log else 'no message'}",
        hint="Leave out images that are unlike the others, and try again.",
    )
