"""The service as a process of its own that stops with the block that started it."""

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

import httpx

_START_SECONDS = 60
_STOP_SECONDS = 20


@contextmanager
def running_service(*, data_dir: Path, models: Path, log: Path, http_port: int, grpc_port: int) -> Iterator[str]:
    """`fastsplat serve` while the block runs: REST, gRPC and one worker, with state in `data_dir`. Yields its key.

    Raises:
        SystemExit: a port is taken, or the service does not get ready; says which and shows the end of its log.
    """
    for port in (http_port, grpc_port):
        _require_free(port)
    environment = {
        **os.environ,
        "FASTSPLAT_DATA_DIR": str(data_dir),
        "FASTSPLAT_MODELS": str(models),
        "FASTSPLAT_HTTP_PORT": str(http_port),
        "FASTSPLAT_GRPC_PORT": str(grpc_port),
        "FASTSPLAT_METRICS_PORT": "0",
    }
    with log.open("wb") as sink:
        # A session of its own, so that whatever it starts can be stopped with it.
        process = subprocess.Popen(
            [Path(sys.executable).parent / "fastsplat", "serve"],
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
            raise SystemExit(f"port {port} is in use; stop what uses it, or pass --http-port and --grpc-port") from None


def _wait_ready(process: subprocess.Popen[bytes], port: int, log: Path) -> None:
    deadline = time.monotonic() + _START_SECONDS
    while time.monotonic() < deadline:
        if process.poll() is not None:
            break
        try:
            if httpx.get(f"http://127.0.0.1:{port}/readyz", timeout=2).is_success:
                return
        except httpx.TransportError:
            pass
        time.sleep(0.2)
    tail = log.read_text(errors="replace")[-3000:]
    raise SystemExit(f"the service did not get ready; the end of {log}:\n{tail}")


def _stop(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(_STOP_SECONDS)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
