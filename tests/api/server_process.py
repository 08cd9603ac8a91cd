"""A server in a process of its own, for tests that send it signals or look at what it leaves behind."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from fastsplat.service.settings import Settings
from tests.waiting import wait_for

SERVE = """
import logging, sys
from fastsplat.api.server import run
from fastsplat.service.settings import Settings
logging.basicConfig(level=logging.INFO)
run(Settings.model_validate_json(sys.argv[1]))
"""
_LISTENS = re.compile(r"HTTP on http://127\.0\.0\.1:(\d+), gRPC on (127\.0\.0\.1:\d+)")


class ServerProcess(NamedTuple):
    """A server that listens, and the file of all that it says."""

    process: subprocess.Popen[bytes]
    log: Path
    http_port: int
    grpc_target: str

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.http_port}"


@contextmanager
def server_process(settings: Settings, code: str = SERVE) -> Iterator[ServerProcess]:
    """Runs until the block ends; its standard input is a pipe."""
    log = settings.data_dir.with_suffix(".log")
    command = [sys.executable, "-c", code, settings.model_dump_json()]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "PYTHONUNBUFFERED": "1"}
    with log.open("w") as said:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=said, stderr=said, env=environment)
    try:
        wait_for(lambda: process.poll() is not None or _LISTENS.search(log.read_text()))
        listens = _LISTENS.search(log.read_text())
        assert listens is not None, log.read_text()
        yield ServerProcess(process, log, int(listens[1]), listens[2])
    finally:
        process.kill()
        process.communicate()
