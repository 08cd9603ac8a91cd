"""Known names over both protocols and in process."""

from __future__ import annotations

import grpc
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.known_names import KnownName
from fastsplat_contract.proto_codec import from_proto
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import assert_same, client_of
from tests.api.made_scene import add_known_name, add_scene
from tests.api.served import Faces, rest_refusal, rpc_refusal


def _ids(client: Client) -> list[str]:
    return [name.id for name in client.known_names.all()]


def test_names_are_listed_and_forgotten_alike(faces: Faces, service: SceneService, api_settings: Settings) -> None:
    service.known_names.forget("all")
    scenes = [add_scene(service, api_settings) for _ in range(3)]
    ids = [add_known_name(service, scene_id, f"mug {number} ☕") for number, scene_id in enumerate(scenes)]
    with client_of(faces) as client:
        truth = service.known_names.list().names
        assert [name.id for name in truth] == ids[::-1] and truth[0].picture == b"\xff\xd8\xff"
        assert_same(tuple(client.known_names.all()), truth)
        page = faces.rpc.ListKnownNames(pb.ListKnownNamesRequest(page_size=2))
        rest = faces.rpc.ListKnownNames(pb.ListKnownNamesRequest(page_token=page.next_page_token))
        assert_same(tuple(from_proto(KnownName, name) for name in (*page.names, *rest.names)), truth)
        client.known_names.forget(ids[0])
        assert _ids(client) == ids[:0:-1]
        faces.rpc.DeleteKnownName(pb.DeleteKnownNameRequest(name_id=ids[1]))
        assert _ids(client) == [ids[2]]
        refused = rest_refusal(faces.rest.delete(f"/v1/known-names/{ids[1]}"))
        with pytest.raises(grpc.RpcError) as raised:
            faces.rpc.DeleteKnownName(pb.DeleteKnownNameRequest(name_id=ids[1]))
        same = rpc_refusal(raised.value)
        assert (refused.reason, refused.detail) == (same.reason, same.detail) and refused.details["field"] == "name_id"
        with pytest.raises(NotFoundError):
            service.known_names.forget(ids[1])
        client.known_names.forget("all")
        assert _ids(client) == []
        faces.rpc.DeleteKnownName(pb.DeleteKnownNameRequest(name_id="all"))
    for scene_id in scenes:
        service.delete_scene(scene_id)
