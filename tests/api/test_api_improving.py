"""Training further, alignment and next photos over both protocols, the client and in process."""

from __future__ import annotations

import grpc
import numpy as np
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat_client import Client
from fastsplat_contract.json_codec import from_json, to_plain
from fastsplat_contract.places import Alignment, PointPair
from fastsplat_contract.poses import Pose, Quaternion, Vector3
from fastsplat_contract.proto_codec import from_proto, to_proto
from fastsplat_contract.scenes import Edit, EditIn, Scene, SceneVersion
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import assert_same
from tests.api.served import Faces, rest_refusal, rpc_refusal


def test_every_face_aligns_alike(faces: Faces, client: Client, service: SceneService, own: str) -> None:
    before = service.get_scene(own)
    points = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.3, 1.0)]
    pairs = tuple(PointPair(Vector3(*one), Vector3(5 - one[1], 2 + one[0], one[2])) for one in points)
    body = EditIn((Edit("align", alignment=Alignment("map", pairs=pairs)),), "the-same-map")
    made = client.align_scene(own, body.edits[0].alignment, request_id=body.request_id)
    posted = faces.rest.post(f"/v1/scenes/{own}:edit", json=to_plain(body))
    assert_same(from_json(SceneVersion, posted.content), made)
    message = to_proto(body)
    message.scene_id = own
    assert_same(from_proto(SceneVersion, faces.rpc.EditScene(message)), made)
    assert made.current and [edit.action for edit in made.edits] == ["align"]
    scene = client.scene(own)
    assert_same(from_proto(Scene, faces.rpc.GetScene(pb.GetSceneRequest(scene_id=own))), scene)
    assert scene.alignment is not None and scene.alignment.frame == "map" and scene.alignment.pairs == 4
    assert scene.alignment.rms == pytest.approx(0, abs=1e-9) and scene.alignment.outliers == ()
    x, y, z = before.cameras[0].world_from_camera[:3, 3]
    assert np.allclose(scene.cameras[0].world_from_camera[:3, 3], [5 - y, 2 + x, z])
    answered = {each.id: each.box for each in client.things(own)}
    back = Alignment("", Pose(Vector3(-2.0, 5.0, 0.0), Quaternion(0.0, 0.0, -np.sqrt(0.5), np.sqrt(0.5))))
    client.align_scene(own, back)
    assert np.allclose(client.scene(own).cameras[0].world_from_camera, before.cameras[0].world_from_camera, atol=1e-6)
    client.undo_edit(own)
    client.undo_edit(own)
    assert client.scene(own).alignment is None
    for each in client.things(own):
        if each.box is not None:
            center, moved = each.box.center.position, answered[each.id].center.position
            assert np.allclose(moved, [5 - center.y, 2 + center.x, center.z], atol=1e-4)


def test_bad_alignments_are_refused_alike(faces: Faces, own: str) -> None:
    pairs = (PointPair(Vector3(0, 0, 0), Vector3(0, 0, 0)),)
    body = EditIn((Edit("align", alignment=Alignment("map", pairs=pairs)),))
    refused = rest_refusal(faces.rest.post(f"/v1/scenes/{own}:edit", json=to_plain(body)))
    message = to_proto(body)
    message.scene_id = own
    with pytest.raises(grpc.RpcError) as caught:
        faces.rpc.EditScene(message)
    over_rpc = rpc_refusal(caught.value)
    assert (over_rpc.reason, over_rpc.detail, over_rpc.details) == (refused.reason, refused.detail, refused.details)
    assert refused.reason == "INVALID_INPUT" and refused.details["field"].endswith("alignment.pairs")
