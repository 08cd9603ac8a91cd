"""Runs the parsers of strangers' data in a child process with limits on memory and time.

What dies there is one request, not the service. The child tells its progress line by line and leaves its result as a
file; see `service.capture.child` for the other side.
"""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from fastsplat.service.capture.settings import CaptureSettings
from fastsplat_contract import errors
from fastsplat_contract.errors import FastSplatError, ReconstructionError, ResourceError

Task = Literal["admit", "probe", "frames", "reconstruct", "triangulate"]
Listener = Callable[[float, str], None]
"""Receives the share of the task that is done, and a line for people; may raise to stop it."""

_ENVIRONMENT = {
    "OMP_WAIT_POLICY": "passive",
    "OPENBLAS_NUM_THREADS": "1",  # its products here are small, and its threads would spin beside the matcher's
    "OPENCV_FFMPEG_CAPTURE_OPTIONS": "protocol_whitelist;file",
}
_HEARTBEAT_S = 2.0


@dataclass(frozen=True)
class _Bounds:
    """What a task may use, and how errors speak of it."""

    what: str
    memory_bytes: int
    memory_setting: str
    seconds: int
    seconds_setting: str

    @property
    def memory_limit(self) -> str:
        return f"{self.memory_bytes} bytes ({self.memory_setting})"


_MEMORY_SIGNS = ("bad_alloc", "cannot allocate", "out of memory", "memoryerror", "failed to map")


def run_isolated(
    task: Task, request: dict[str, Any], folder: Path, settings: CaptureSettings, listen: Listener
) -> dict[str, Any]:
    """Run one task of `service.capture.child` in `folder`, an empty folder of its own, and return its result.

    Raises:
        FastSplatError: the typed error that the task raised.
        ResourceError: it hit its memory limit or time limit, or crashed, which is what C++ without memory does.
        ReconstructionError: the child failed of something else; for "admit", where nothing else is to be expected, a
            RuntimeError.
        CancelledError: whatever `listen` raised; the child is gone by then.
    """
    bounds = _bounds(task, settings)
    limits = {"memory_bytes": bounds.memory_bytes, "memory_limit": bounds.memory_limit, "what": bounds.what}
    (folder / "request.json").write_text(json.dumps({**request, **limits}))
    with (folder / "log.txt").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "fastsplat.service.capture.child", task, str(folder)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=log,
            env={
                **os.environ,
                "OMP_WAIT_POLICY": "passive",
                "OPENCV_FFMPEG_CAPTURE_OPTIONS": "protocol_whitelist;file",
            },
        )
    try:
        _follow(process, bounds, listen)
        status = process.wait()
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()
    return _result(task, status, folder, bounds)


def _bounds(task: Task, settings: CaptureSettings) -> _Bounds:
    if task == "admit":
        return _Bounds(
            "looking into the upload",
            settings.admit_memory_bytes,
            "FASTSPLAT_CAPTURE__ADMIT_MEMORY_BYTES",
            settings.admit_seconds,
            "FASTSPLAT_CAPTURE__ADMIT_SECONDS",
        )
    return _Bounds(
        "finding camera poses",
        settings.sfm_memory_bytes,
        "FASTSPLAT_CAPTURE__SFM_MEMORY_BYTES",
        settings.sfm_seconds,
        "FASTSPLAT_CAPTURE__SFM_SECONDS",
    )


def _follow(process: subprocess.Popen[bytes], bounds: _Bounds, listen: Listener) -> None:
    """Pass progress on until the child closes its output; repeat the last when it is silent, so that one can cancel."""
    assert process.stdout is not None
    deadline = time.monotonic() + bounds.seconds
    descriptor = process.stdout.fileno()
    waiting, last = b"", (0.0, "starting")
    with selectors.DefaultSelector() as selector:
        selector.register(descriptor, selectors.EVENT_READ)
        while True:
            if time.monotonic() > deadline:
                raise ResourceError(
                    f"{bounds.what} took too long",
                    limit=f"{bounds.seconds} s ({bounds.seconds_setting})",
                    hint="Send fewer images.",
                )
            if selector.select(_HEARTBEAT_S):
                chunk = os.read(descriptor, 1 << 16)
                if not chunk:
                    return
                *lines, waiting = (waiting + chunk).split(b"\n")
                for line in lines:
                    fraction, message = json.loads(line)
                    last = (float(fraction), str(message))
                    listen(*last)
            else:
                listen(*last)


def _result(task: Task, status: int, folder: Path, bounds: _Bounds) -> dict[str, Any]:
    path = folder / "result.json"
    if status == 0 and path.is_file():
        result: dict[str, Any] = json.loads(path.read_text())
        if "error" not in result:
            return result
        raised: dict[str, str] = result["error"]
        kind = getattr(errors, raised.pop("type"))
        assert issubclass(kind, FastSplatError)
        raise kind(raised.pop("message"), **raised)
    log = (folder / "log.txt").read_text(errors="replace").strip().splitlines()
    if status < 0 or any(sign in " ".join(log[-8:]).lower() for sign in _MEMORY_SIGNS):
        # C++ that gets no memory does not always say so: some of it writes through the null pointer.
        raise ResourceError(
            f"{bounds.what} ended by {f'signal {-status}' if status < 0 else 'an error'}, "
            "as it does when it runs out of memory",
            limit=bounds.memory_limit,
            hint="Send fewer or smaller images, or raise the limit.",
        )
    if task == "admit":
        raise RuntimeError(f"the child that looks into uploads ended with status {status}: {' | '.join(log[-8:])}")
    raise ReconstructionError(
        f"the {task} process ended with status {status}: {log[-1][:300] if log else 'no message'}",
        hint="Leave out images that are unlike the others, and try again.",
    )
