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


def test_a_known_length_makes_the_scene_metric_and_undo_takes_it_back(client: Client, fresh_id: str) -> None:
    before, boxes = client.scene(fresh_id), [obj.box for obj in client.objects(fresh_id)]
    mask = client.mask3d(fresh_id, "mug")
    depth = client.depth(fresh_id, "front.png")
    version = client.scale_scene(fresh_id, KnownLength(_FROM, _TO, 0.25, 0.001))
    assert version.edits == (Edit("scale", known_lengths=(KnownLength(_FROM, _TO, 0.25, 0.001),)),)
    after = client.scene(fresh_id)
    assert after.scale == "METRIC" and after.scaling is not None
    assert (after.scaling.source, after.scaling.known_lengths) == ("known_length", 1)
    assert after.scaling.meters_per_unit == pytest.approx(0.5)
    assert after.scaling.low < 0.5 < after.scaling.high
    for posed, old in zip(after.cameras, before.cameras, strict=True):
        np.testing.assert_allclose(posed.world_from_camera[:3, 3], old.world_from_camera[:3, 3] / 2)
    for obj, box in zip(client.objects(fresh_id), boxes, strict=True):
        assert obj.box is not None and box is not None and obj.meters
        np.testing.assert_allclose(obj.box.size, np.divide(box.size, 2), rtol=1e-3)
        np.testing.assert_allclose(obj.box.center.position, np.divide(box.center.position, 2), atol=1e-4)
    np.testing.assert_allclose(client.depth(fresh_id, "front.png"), depth / 2, rtol=1e-3)
    assert (client.mask3d(fresh_id, "mug") == mask).all()

    # Another edit keeps the scale; a second length is combined with the first.
    client.edit_scene(fresh_id, [Edit("remove", label="ball")])
    assert client.scene(fresh_id).scaling == after.scaling
    half = Place(point=Vector3(0.25, 0.0, 0.0))  # in meters now
    client.scale_scene(fresh_id, KnownLength(_FROM, half, 0.26, 0.001))
    more = client.scene(fresh_id).scaling
    assert more is not None and more.known_lengths == 2 and more.meters_per_unit == pytest.approx(0.51, abs=0.002)
    for _ in range(3):
        client.undo_edit(fresh_id)
    assert replace(client.scene(fresh_id), cameras=()) == replace(before, cameras=())
    assert (client.scene(fresh_id).cameras[0].world_from_camera == before.cameras[0].world_from_camera).all()
    client.redo_edit(fresh_id)
    assert client.scene(fresh_id).scaling == after.scaling


def test_a_scene_and_all_in_it_are_put_into_the_frame_of_a_map_and_taken_back(
    client: Client, service: SceneService, fresh_id: str
) -> None:
    before = service.get_scene(fresh_id)
    points = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.3, 1.0)]
    pairs = tuple(PointPair(Vector3(*point), Vector3(5 - point[1], 2 + point[0], point[2])) for point in points)
    version = client.align_scene(fresh_id, Alignment("map", pairs=pairs))
    assert version.current and [edit.action for edit in version.edits] == ["align"]
    scene = client.scene(fresh_id)
    assert scene.alignment is not None and scene.alignment.frame == "map" and scene.alignment.pairs == 4
    assert scene.alignment.rms == pytest.approx(0, abs=1e-9) and scene.alignment.outliers == ()
    x, y, z = before.cameras[0].world_from_camera[:3, 3]
    assert np.allclose(scene.cameras[0].world_from_camera[:3, 3], [5 - y, 2 + x, z])
    answered = {obj.id: obj.box for obj in client.objects(fresh_id)}
    back = Alignment("", Pose(Vector3(-2.0, 5.0, 0.0), Quaternion(0.0, 0.0, -np.sqrt(0.5), np.sqrt(0.5))))
    client.align_scene(fresh_id, back)
    assert np.allclose(
        client.scene(fresh_id).cameras[0].world_from_camera, before.cameras[0].world_from_camera, atol=1e-6
    )
    client.undo_edit(fresh_id)
    client.undo_edit(fresh_id)
    assert client.scene(fresh_id).alignment is None
    for obj in client.objects(fresh_id):
        if obj.box is not None:
            center, moved = obj.box.center.position, answered[obj.id].center.position
            assert np.allclose(moved, [5 - center.y, 2 + center.x, center.z], atol=1e-4)
