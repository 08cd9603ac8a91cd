"""Renaming a scene by two at once."""

from __future__ import annotations

import threading

import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import ConflictError
from fastsplat_contract.scenes import SceneUpdate
from tests.api.made_scene import add_scene


@pytest.fixture
def scene(service: SceneService, api_settings: Settings) -> str:
    """A scene of one test, which the server of all tests keeps."""
    return add_scene(service, api_settings, "made")


def test_of_two_at_once_that_expect_the_same_name_one_wins(service: SceneService, scene: str) -> None:
    outcomes: list[str] = []
    start = threading.Barrier(2)

    def rename(name: str) -> None:
        start.wait()
        try:
            outcomes.append(service.update_scene(scene, SceneUpdate(name, "made")).name)
        except ConflictError:
            outcomes.append("")

    threads = [threading.Thread(target=rename, args=(name,)) for name in ("one", "two")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(outcomes)[0] == "" and outcomes.count("") == 1
    assert service.get_scene(scene).name in outcomes
    service.delete_scene(scene)
