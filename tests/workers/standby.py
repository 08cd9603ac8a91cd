"""Processes that wait for what to run with their imports done, which are most of a worker's start."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import deque
from pathlib import Path

_ROOT = Path(__file__).parent.parent.parent
_WAIT = """
import json, os, resource, sys, {module}
line = sys.stdin.readline()
if not line:
    sys.exit()  # the tests are over
order = json.loads(line)
os.environ.clear()
os.environ.update(order["environment"])
if order["max_file"]:
    resource.setrlimit(resource.RLIMIT_FSIZE, (order["max_file"], order["max_file"]))
exec(order["code"], {{"__name__": "__main__"}})
"""


class StandbyProcesses:
    """Some processes that have imported a module; a new one takes the place of each that is used."""

    def __init__(self, module: str, count: int) -> None:
        self._module = module
        self._count = count
        self._waiting: deque[subprocess.Popen[bytes]] = deque()

    def run(self, code: str, environment: dict[str, str], max_file: int = 0) -> subprocess.Popen[bytes]:
        """Have one run Python code, in that environment and no other, in a session of its own."""
        self._fill()
        process = self._waiting.popleft()
        self._fill()
        assert process.stdin is not None
        process.stdin.write(json.dumps({"code": code, "environment": environment, "max_file": max_file}).encode())
        process.stdin.close()
        return process

    def close(self) -> None:
        while self._waiting:
            process = self._waiting.popleft()
            assert process.stdin is not None
            process.stdin.close()
            process.wait()

    def _fill(self) -> None:
        while len(self._waiting) < self._count:
            command = [sys.executable, "-c", _WAIT.format(module=self._module)]
            environment = {**os.environ, "PYTHONPATH": str(_ROOT)}
            process = subprocess.Popen(command, stdin=subprocess.PIPE, env=environment, start_new_session=True)
            self._waiting.append(process)


WORKERS = StandbyProcesses("fastsplat.workers.engine.worker", 2)
APIS = StandbyProcesses("fastsplat.api.server", 1)
