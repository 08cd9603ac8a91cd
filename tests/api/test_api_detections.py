"""Things as robots need them, over both protocols, by the client, by the command line and in process."""

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


def test_detections_are_the_things_listed(service: SceneService, client: Client, upright_id: str) -> None:
    truth = service.detections.all(upright_id)
    assert_same(client.detection_page(upright_id), truth)
    assert_same(tuple(client.detections(upright_id)), truth.detections)
    listed = service.answers.list_things(upright_id).things
    assert [(each.thing_id, each.label, each.box) for each in truth.detections] == [
        (thing.id, thing.name, thing.box) for thing in listed
    ]
    assert truth.meters and truth.frame_id == "scene" and truth.up is not None
    mug = next(each for each in truth.detections if each.label == "mug")
    assert mug.support is not None and mug.support.label == "floor"  # the floor of that scene is called so
    assert mug.views and (mug.first_seen, mug.proposed_in) == (None, ())
