"""`fastsplat status --here`: well, or why not."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import Result

from fastsplat.service.settings import load_settings
from fastsplat.service.store.store import open_store
from fastsplat.workers.engine.process_group import machine_id
from tests.client.scripted import scripted
from tests.commands import invoke


@pytest.fixture
def health(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Result]]:
    def call(role: str, port: int = 1) -> Result:
        monkeypatch.setenv("FASTSPLAT_HTTP_PORT", str(port))
        load_settings.cache_clear()
        return invoke("status", "--here", role)

    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path))
    yield call
    load_settings.cache_clear()


def test_a_worker_is_well_while_its_heartbeat_is_fresh(health: Callable[..., Result], tmp_path: Path) -> None:
    store = open_store(tmp_path)
    store.workers.update_heartbeat("elsewhere", "another machine", 1)
    stalled = health("worker")
    assert stalled.exit_code == 1 and "had a heartbeat" in stalled.stderr
    store.workers.update_heartbeat("here", machine_id(), os.getpid())
    assert health("worker").exit_code == 0
    store.workers.mark_stopped("here")
    assert health("worker").exit_code == 1
    store.close()


@pytest.mark.parametrize("status", [200, 503])
def test_the_api_is_well_when_it_says_so(health: Callable[..., Result], status: int) -> None:
    with scripted() as server:
        server.script = [(status, {}, b"")]
        result = health("api", server.server_port)
    assert [request for request, _, _ in server.seen] == ["GET /readyz"]
    assert result.exit_code == (status != 200) and bool(result.stderr) == (status != 200)


def test_an_api_that_is_not_there_is_not_well(health: Callable[..., Result]) -> None:
    result = health("api")
    assert result.exit_code == 1 and "does not answer" in result.stderr
