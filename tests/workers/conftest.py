"""Deployments: one a test, or one with a worker for all tests of a file that do not end the worker."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.postgres import PostgresServer
from tests.workers.deployment import Deployment
from tests.workers.standby import APIS, WORKERS


@pytest.fixture(scope="session", autouse=True)
def _end_standbys() -> Iterator[None]:
    """Processes that wait for a test end with the last one."""
    yield
    WORKERS.close()
    APIS.close()


@pytest.fixture
def deployment(tmp_path: Path, database_url: str) -> Iterator[Deployment]:
    """A fresh data folder; its processes are gone when the test ends."""
    deployment = Deployment(tmp_path, database_url)
    yield deployment
    deployment.close()


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def shared_deployment(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployment]:
    """A data folder with one worker, which lives as long as the tests of this file."""
    folder = tmp_path_factory.mktemp("deployment")
    if request.param == "sqlite":
        yield from _with_worker(Deployment(folder, ""))
        return
    server: PostgresServer = request.getfixturevalue("postgres")
    with server.database() as url:
        yield from _with_worker(Deployment(folder, url))


def _with_worker(deployment: Deployment) -> Iterator[Deployment]:
    worker = deployment.start_worker()
    yield deployment
    assert worker.poll() is None  # no test may cost the worker its life
    deployment.close()
