"""The made room, once for all tests that only look at it."""

from __future__ import annotations

import pytest

from tests.instances.made_room import Room, make_room


@pytest.fixture(scope="session")
def room(tmp_path_factory: pytest.TempPathFactory) -> Room:
    return make_room(tmp_path_factory.mktemp("room"))
