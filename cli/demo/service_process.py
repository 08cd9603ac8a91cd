"""Runs the service as a process that stops with the block that started it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fastsplat.cli.operating.browser import is_ready
from fastsplat.service.common.process import PARENT_VARIABLE
from fastsplat_contract.errors import ResourceError

_START_SECONDS = 300
_STOP_SECONDS = 20


@contextmanager
def running_service(*, data_dir: Path, models: Path, log: Path, http_port: int, grpc_port: int) -> Iterator[str]:
    """Runs `fastsplat serve` with one worker; yields its key, or raises `ResourceError` with its log."""
    for port in (http_port, grpc_port):
        _require_free(port)
    environment = {
        **os.environ,
        PARENT_VARIABLE: str(os.getpid()),  # killed, this process could not stop it
        "FASTSPLAT_DATA_DIR": str(data_dir),
        "FASTSPLAT_MODELS": str(models),
        "FASTSPLAT_HTTP_PORT": str(http_port),
        "FASTSPLAT_GRPC_PORT": str(grpc_port),
        "FASTSPLAT_METRICS_PORT": "0",
    }
    with log.open("wb") as sink:
        # A session of its own, so that whatever it starts can be stopped with it.
        process = subprocess.Popen(
            [sys.executable, "-m", "fastsplat.cli.main", "serve"],
            env=environment,
            stdout=sink,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        _wait_ready(process, http_port, log)
        yield (data_dir / "key").read_text().strip()
    finally:
        _stop(process)


def _require_free(port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            raise ResourceError(
                f"port {port} is in use",
                field="http_port",
                hint="Stop what uses it, or set FASTSPLAT_HTTP_PORT and FASTSPLAT_GRPC_PORT.",
            ) from None


def _wait_ready(process: subprocess.Popen[bytes], port: int, log: Path) -> None:
    deadline = time.monotonic() + _START_SECONDS
    while time.monotonic() < deadline:
        if process.poll() is not None:
            break
        if is_ready(f"http://127.0.0.1:{port}"):
            return
        time.sleep(0.2)
    tail = log.read_text(errors="replace")[-3000:]
    raise ResourceError(f"the service did not get ready; the end of {log}:\n{tail}")


def _stop(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(_STOP_SECONDS)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
