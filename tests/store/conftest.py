"""A store to write to."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from fastsplat.service.store.store import Store, open_store


@pytest.fixture
def store(tmp_path: Path, database_url: str) -> Iterator[Store]:
    """An empty one, over each database that a test is run with."""
    opened = open_store(tmp_path / "data", database_url)
    yield opened
    opened.close()
