"""Houses: one a test, or one with a worker for all tests of a file that kill neither."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.postgres import PostgresServer
from tests.workers.house import House


@pytest.fixture
def house(tmp_path: Path, database_url: str) -> Iterator[House]:
    """A fresh data folder; its processes are gone when the test ends."""
    house = House(tmp_path, database_url)
    yield house
    house.close()


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def busy_house(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[House]:
    """A data folder with one worker, which lives as long as the tests of this file."""
    folder = tmp_path_factory.mktemp("house")
    if request.param == "sqlite":
        yield from _with_worker(House(folder, ""))
        return
    server: PostgresServer = request.getfixturevalue("postgres")
    with server.database() as url:
        yield from _with_worker(House(folder, url))


def _with_worker(house: House) -> Iterator[House]:
    worker = house.start_worker()
    yield house
    assert worker.poll() is None  # no test may cost the worker its life
    house.close()
