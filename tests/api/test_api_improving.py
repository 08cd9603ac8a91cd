"""Scenes put into the frame of a map by the client, and taken back."""

from __future__ import annotations

import numpy as np
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat_client import Client
from fastsplat_contract.places import Alignment, PointPair
from fastsplat_contract.poses import Pose, Quaternion, Vector3


def test_a_scene_and_all_in_it_are_put_into_the_frame_of_a_map_and_taken_back(
    client: Client, service: SceneService, own: str
) -> None:
    before = service.get_scene(own)
    points = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.3, 1.0)]
    pairs = tuple(PointPair(Vector3(*one), Vector3(5 - one[1], 2 + one[0], one[2])) for one in points)
    made = client.align_scene(own, Alignment("map", pairs=pairs))
    assert made.current and [edit.action for edit in made.edits] == ["align"]
    scene = client.scene(own)
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
