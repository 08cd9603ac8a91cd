"""Where a robot stands to see a thing, over both protocols, by the client and in process."""

from __future__ import annotations

import grpc
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_contract.goal_messages import Goal
from fastsplat_contract.proto_codec import from_proto
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import assert_same
from tests.api.served import Faces, rest_refusal, rpc_refusal
from tests.api.upright_scene import add_upright_scene


@pytest.fixture(scope="module")
def upright_id(service: SceneService, api_settings: Settings) -> str:
    return add_upright_scene(service, api_settings)


def test_every_face_names_the_same_place(faces: Faces, service: SceneService, client: Client, upright_id: str) -> None:
    (mug,) = [thing.id for thing in service.answers.list_things(upright_id).things if thing.name == "mug"]
    truth = service.exports.goal(upright_id, mug, 0.15)
    assert_same(client.goal(upright_id, mug, 0.15), truth)
    message = pb.GetGoalRequest(scene_id=upright_id, thing_id=mug, robot_radius=0.15)
    assert_same(from_proto(Goal, faces.rpc.GetGoal(message)), truth)
    assert 0.2 <= truth.distance < 0.6 and truth.clearance >= 0.2
    assert truth.floor_source == "lowest_level", "labels alone do not say that a thing is flat"
    assert truth.thing_id == mug and truth.version == service.versions.resolve(upright_id)
    assert service.exports.goal(upright_id, mug) == service.exports.goal(upright_id, mug, 0.2)


def test_both_faces_refuse_alike(
    faces: Faces, service: SceneService, api_settings: Settings, upright_id: str, scene_id: str
) -> None:
    table_id = add_upright_scene(service, api_settings, "dining table")
    for scene, thing, radius, code, field in (
        (scene_id, 1, 0.2, 400, "scene_id"),  # its z is not up
        (table_id, 1, 0.2, 400, "scene_id"),  # its lowest level is a table top
        (upright_id, 4_000, 0.2, 404, "thing_id"),
        (upright_id, 1, 5.0, 404, "thing_id"),  # no free place for a robot that wide
        (upright_id, 1, -1.0, 400, "robot_radius"),
    ):
        params = {"thing_id": thing, "robot_radius": radius}
        refused = rest_refusal(faces.rest.get(f"/v1/scenes/{scene}/goal", params=params))
        with pytest.raises(grpc.RpcError) as caught:
            faces.rpc.GetGoal(pb.GetGoalRequest(scene_id=scene, thing_id=thing, robot_radius=radius))
        assert refused.code == code and refused.details["field"].endswith(field)
        assert rpc_refusal(caught.value).reason == refused.reason
