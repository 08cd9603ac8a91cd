"""Deployments of a test or file; `on_both_databases` adds PostgreSQL where its SQL or locking differs."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.workers.deployment import Deployment, new_database
from tests.workers.standby import APIS, WORKERS


@pytest.fixture(scope="session", autouse=True)
def _end_standbys() -> Iterator[None]:
    """Processes that wait for a test end with the last one."""
    yield
    WORKERS.close()
    APIS.close()


@pytest.fixture
def deployment(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Deployment]:
    """A fresh data folder; its processes are gone when the test ends."""
    with ExitStack() as opened:
        deployment = Deployment(tmp_path, new_database(request, opened))
        yield deployment
        deployment.close()


@pytest.fixture
def shared_deployment(_with_workers: Callable[[str], Deployment], request: pytest.FixtureRequest) -> Deployment:
    """A data folder with one worker, which lives as long as the tests of this file."""
    return _with_workers(getattr(request, "param", "sqlite"))


@pytest.fixture(scope="module")
def _with_workers(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[[str], Deployment]]:
    """The shared deployment of each database, made when a test asks for it first."""
    deployments: dict[str, Deployment] = {}
    workers: list[subprocess.Popen[bytes]] = []
    with ExitStack() as opened:

        def with_worker(database: str) -> Deployment:
            if database not in deployments:
                url = new_database(request, opened, database)
                deployments[database] = Deployment(tmp_path_factory.mktemp("deployment"), url)
                workers.append(deployments[database].start_worker())
            return deployments[database]

        yield with_worker
        running = [worker.poll() is None for worker in workers]
        for deployment in deployments.values():
            deployment.close()
    assert all(running)  # no test may cost the worker its life
