"""What robots need, by the client and in process: detections, and where to stand to see a thing."""

from __future__ import annotations

from fastsplat.service.application.service import SceneService
from fastsplat_client import Client
from tests.api.clients import assert_same


def test_detections_are_the_things_listed(service: SceneService, client: Client, upright_id: str) -> None:
    truth = service.detections.all(upright_id)
    assert_same(client.detection_page(upright_id), truth)
    assert_same(tuple(client.detections(upright_id)), truth.detections)
    listed = service.answers.list_things(upright_id).things
    assert [(each.thing_id, each.label, each.box) for each in truth.detections] == [
        (thing.id, thing.name, thing.box) for thing in listed
    ]
    assert truth.meters and truth.frame_id == "world" and truth.up is not None
    mug = next(each for each in truth.detections if each.label == "mug")
    assert mug.support is not None and mug.support.label == "floor"  # the floor of that scene is called so
    assert mug.views and (mug.first_seen, mug.proposed_in) == (None, ())


def test_a_goal_is_where_a_robot_can_stand(service: SceneService, client: Client, upright_id: str) -> None:
    (mug,) = [thing.id for thing in service.answers.list_things(upright_id).things if thing.name == "mug"]
    truth = service.exports.goal(upright_id, mug, 0.15)
    assert_same(client.goal(upright_id, mug, 0.15), truth)
    assert 0.2 <= truth.distance < 0.6 and truth.clearance >= 0.2
    assert truth.floor_source == "lowest_level", "labels alone do not say that a thing is flat"
    assert truth.thing_id == mug and truth.version == service.versions.resolve(upright_id)
    assert service.exports.goal(upright_id, mug) == service.exports.goal(upright_id, mug, 0.2)
