"""`fastsplat health`: well, or why not."""

from __future__ import annotations

import http.server
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from fastsplat.service.store import open_store
from fastsplat.workers.process_group import machine_id

ROOT = Path(__file__).parent.parent.parent


def health(role: str, folder: Path, port: int = 1) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "FASTSPLAT_DATA_DIR": str(folder), "FASTSPLAT_HTTP_PORT": str(port)}
    command = [sys.executable, "-m", "fastsplat.cli.main", "health", role]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=60)


def test_a_worker_is_well_while_its_heartbeat_is_fresh(tmp_path: Path) -> None:
    store = open_store(tmp_path)
    store.workers.update_heartbeat("elsewhere", "another machine", 1)
    silent = health("worker", tmp_path)
    assert silent.returncode == 1 and "had a heartbeat" in silent.stderr
    store.workers.update_heartbeat("here", machine_id(), os.getpid())
    assert health("worker", tmp_path).returncode == 0
    store.workers.mark_stopped("here")
    assert health("worker", tmp_path).returncode == 1
    store.close()


@pytest.mark.parametrize("status", [200, 503])
def test_the_api_is_well_when_it_says_so(tmp_path: Path, status: int) -> None:
    asked = []

    class Answer(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            self.send_response(status)
            self.end_headers()

        def log_message(self, *_: object) -> None: ...

    with http.server.HTTPServer(("127.0.0.1", 0), Answer) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        found = health("api", tmp_path, server.server_port)
        server.shutdown()
    assert asked == ["/readyz"]
    assert found.returncode == (status != 200) and bool(found.stderr) == (status != 200)


def test_an_api_that_is_not_there_is_not_well(tmp_path: Path) -> None:
    found = health("api", tmp_path)
    assert found.returncode == 1 and "does not answer" in found.stderr
