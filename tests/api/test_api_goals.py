"""Where a robot stands to see a thing, over both protocols, by the client and in process."""

from __future__ import annotations

import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from tests.api.clients import assert_same
from tests.api.upright_scene import add_upright_scene


@pytest.fixture(scope="module")
def upright_id(service: SceneService, api_settings: Settings) -> str:
    return add_upright_scene(service, api_settings)


def test_a_goal_is_where_a_robot_can_stand(service: SceneService, client: Client, upright_id: str) -> None:
    (mug,) = [thing.id for thing in service.answers.list_things(upright_id).things if thing.name == "mug"]
    truth = service.exports.goal(upright_id, mug, 0.15)
    assert_same(client.goal(upright_id, mug, 0.15), truth)
    assert 0.2 <= truth.distance < 0.6 and truth.clearance >= 0.2
    assert truth.floor_source == "lowest_level", "labels alone do not say that a thing is flat"
    assert truth.thing_id == mug and truth.version == service.versions.resolve(upright_id)
    assert service.exports.goal(upright_id, mug) == service.exports.goal(upright_id, mug, 0.2)
