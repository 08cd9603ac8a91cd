"""Things as robots need them, over both protocols, by the client, by the command line and in process."""

from __future__ import annotations

import grpc
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_contract.detection_messages import DetectionList
from fastsplat_contract.proto_codec import from_proto
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import assert_same
from tests.api.served import Faces, rest_refusal, rpc_refusal
from tests.api.upright_scene import add_upright_scene


@pytest.fixture(scope="module")
def upright_id(service: SceneService, api_settings: Settings) -> str:
    return add_upright_scene(service, api_settings)


def test_every_face_says_the_same(faces: Faces, service: SceneService, client: Client, upright_id: str) -> None:
    truth = service.detections.all(upright_id)
    assert_same(client.detection_page(upright_id), truth)
    assert_same(tuple(client.detections(upright_id)), truth.detections)
    message = faces.rpc.ListDetections(pb.ListDetectionsRequest(scene_id=upright_id))
    assert_same(from_proto(DetectionList, message), truth)
    listed = service.answers.list_things(upright_id).things
    assert [(each.thing_id, each.label, each.box) for each in truth.detections] == [
        (thing.id, thing.name, thing.box) for thing in listed
    ]
    assert truth.meters and truth.frame_id == "scene" and truth.up is not None
    mug = next(each for each in truth.detections if each.label == "mug")
    assert mug.support is not None and mug.support.label == "floor"  # the floor of that scene is called so
    assert mug.views and (mug.first_seen, mug.proposed_in) == (None, ())


def test_pages_make_the_whole(faces: Faces, service: SceneService, upright_id: str) -> None:
    first = service.detections.all(upright_id, page_size=1)
    second = service.detections.all(upright_id, page_size=1, page_token=first.next_page_token)
    assert first.next_page_token and not second.next_page_token
    assert first.detections + second.detections == service.detections.all(upright_id).detections
    assert first[2:] == second[2:]


def test_both_faces_refuse_alike(faces: Faces, upright_id: str) -> None:
    for scene, fields, code in (
        ("0" * 32, {}, 404),
        (upright_id, {"version": "9"}, 404),
        (upright_id, {"page_token": "not one of ours"}, 400),
        (upright_id, {"page_size": -1}, 400),
    ):
        refused = rest_refusal(faces.rest.get(f"/v1/scenes/{scene}/detections", params=fields))
        with pytest.raises(grpc.RpcError) as caught:
            faces.rpc.ListDetections(pb.ListDetectionsRequest(scene_id=scene, **fields))
        assert refused.code == code and rpc_refusal(caught.value).reason == refused.reason
