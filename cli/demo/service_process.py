"""Runs the service as a process that stops with the block that started it."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fastsplat.cli.operating.browser import is_ready
from fastsplat.cli.operating.serve_command import require_free_ports
from fastsplat.service.library.training_run import running_command
from fastsplat_contract.errors import ResourceError

_START_SECONDS = 300


@contextmanager
def running_service(*, data_dir: Path, models: Path, log: Path, http_port: int, grpc_port: int) -> Iterator[str]:
    """Runs `fastsplat serve` with one worker; yields its key, or raises `ResourceError` with its log."""
    require_free_ports("127.0.0.1", http_port=http_port, grpc_port=grpc_port)
    environment = {
        **os.environ,
        "FASTSPLAT_DATA_DIR": str(data_dir),
        "FASTSPLAT_MODELS": str(models),
        "FASTSPLAT_HTTP_PORT": str(http_port),
        "FASTSPLAT_GRPC_PORT": str(grpc_port),
        "FASTSPLAT_METRICS_PORT": "0",
    }
    with running_command("serve", environment, log) as process:
        _wait_ready(process, http_port, log)
        yield (data_dir / "key").read_text().strip()


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
