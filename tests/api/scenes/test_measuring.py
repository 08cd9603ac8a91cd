"""The scale of a scene by known lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat_client import Client, KnownLength, Place, Vector3
from fastsplat_contract.geometry.places import Alignment, PointPair
from fastsplat_contract.geometry.poses import Pose, Quaternion
from fastsplat_contract.messages.scenes import Edit

_FROM, _TO = Place(point=Vector3(0.0, 0.0, 0.0)), Place(point=Vector3(0.5, 0.0, 0.0))


def test_a_known_length_makes_the_scene_metric_and_undo_takes_it_back(client: Client, own: str) -> None:
    before, boxes = client.scene(own), [obj.box for obj in client.objects(own)]
    mask = client.mask3d(own, "mug")
    depth = client.depth(own, "front.png")
    made = client.scale_scene(own, KnownLength(_FROM, _TO, 0.25, 0.001))
    assert made.edits == (Edit("scale", known_lengths=(KnownLength(_FROM, _TO, 0.25, 0.001),)),)
    after = client.scene(own)
    assert after.scale == "METRIC" and after.scaling is not None
    assert (after.scaling.source, after.scaling.known_lengths) == ("known_length", 1)
    assert after.scaling.meters_per_unit == pytest.approx(0.5)
    assert after.scaling.low < 0.5 < after.scaling.high
    for posed, old in zip(after.cameras, before.cameras, strict=True):
        np.testing.assert_allclose(posed.world_from_camera[:3, 3], old.world_from_camera[:3, 3] / 2)
    for obj, box in zip(client.objects(own), boxes, strict=True):
        assert obj.box is not None and box is not None and obj.meters
        np.testing.assert_allclose(obj.box.size, np.divide(box.size, 2), rtol=1e-3)
        np.testing.assert_allclose(obj.box.center.position, np.divide(box.center.position, 2), atol=1e-4)
    np.testing.assert_allclose(client.depth(own, "front.png"), depth / 2, rtol=1e-3)
    assert (client.mask3d(own, "mug") == mask).all()

    # Another edit keeps the scale; a second length is combined with the first.
    client.edit_scene(own, [Edit("remove", label="ball")])
    assert client.scene(own).scaling == after.scaling
    half = Place(point=Vector3(0.25, 0.0, 0.0))  # in meters now
    client.scale_scene(own, KnownLength(_FROM, half, 0.26, 0.001))
    more = client.scene(own).scaling
    assert more is not None and more.known_lengths == 2 and more.meters_per_unit == pytest.approx(0.51, abs=0.002)
    for _ in range(3):
        client.undo_edit(own)
    assert replace(client.scene(own), cameras=()) == replace(before, cameras=())
    assert (client.scene(own).cameras[0].world_from_camera == before.cameras[0].world_from_camera).all()
    client.redo_edit(own)
    assert client.scene(own).scaling == after.scaling


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
    answered = {each.id: each.box for each in client.objects(own)}
    back = Alignment("", Pose(Vector3(-2.0, 5.0, 0.0), Quaternion(0.0, 0.0, -np.sqrt(0.5), np.sqrt(0.5))))
    client.align_scene(own, back)
    assert np.allclose(client.scene(own).cameras[0].world_from_camera, before.cameras[0].world_from_camera, atol=1e-6)
    client.undo_edit(own)
    client.undo_edit(own)
    assert client.scene(own).alignment is None
    for each in client.objects(own):
        if each.box is not None:
            center, moved = each.box.center.position, answered[each.id].center.position
            assert np.allclose(moved, [5 - center.y, 2 + center.x, center.z], atol=1e-4)
