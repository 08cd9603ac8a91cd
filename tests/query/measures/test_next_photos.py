"""Where to stand for the next photos: at the edges of gaps, not in walls, in words, and nowhere where all is well."""

from __future__ import annotations

import numpy as np
import pytest

from fastsplat.service.query.measures.next_viewpoints import next_photos
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.poses import look_at
from fastsplat_contract.photos.next_photos import NextPhoto
from tests.query.conftest import DrawnEncoder
from tests.scenes import labelled_scene

_CAMERA = Camera(64, 48, 60.0, 60.0, 32.0, 24.0)


def _index(scene: Scene) -> SceneIndex:
    return SceneIndex(scene, DrawnEncoder(), QuerySettings())


def _ring(degrees: list[float], radius: float = 3.0) -> list[PosedCamera]:
    """Upright cameras around the z axis that look at the origin."""
    cameras = []
    for angle in np.radians(degrees):
        place = np.array([radius * np.cos(angle), radius * np.sin(angle), 1.0])
        cameras.append(PosedCamera(_CAMERA, look_at(place, (0, 0, 0)), f"{np.degrees(angle):03.0f}.jpg"))
    return cameras


def _scene(cameras: list[PosedCamera], extra: np.ndarray | None = None) -> Scene:
    means = np.random.default_rng(3).normal(0, 0.3, size=(400, 3))
    if extra is not None:
        means = np.concatenate([means, extra])
    return labelled_scene(means, np.ones(len(means), int), ["table"], scales=0.05, cameras=cameras)


def _angle(photo: NextPhoto) -> float:
    x, y = photo.camera.world_from_camera[:2, 3]
    return float(np.degrees(np.arctan2(y, x)) % 360)


def test_one_stands_beside_the_edges_of_a_gap() -> None:
    photos = next_photos(_index(_scene(_ring([float(a) for a in range(0, 240, 20)]))))
    assert [photo.reason for photo in photos[:2]] == ["gap", "gap"]
    assert sorted(round(_angle(photo)) for photo in photos[:2]) == [245, 335]  # 25° beside 220° and 0°
    assert sorted(photo.near for photo in photos[:2]) == ["000.jpg", "220.jpg"]
    for photo in photos[:2]:
        assert photo.advice.startswith("Stand ") and photo.near in photo.advice and "look at the table" in photo.advice
        pose = photo.camera.world_from_camera
        aim = -pose[:3, 3] / np.linalg.norm(pose[:3, 3])
        assert pose[:3, 2] @ aim > 0.99  # it looks at what all look at
        assert np.allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3)) and np.linalg.det(pose[:3, :3]) > 0


def test_left_and_right_are_as_in_the_photo() -> None:
    photos = {photo.near: photo for photo in next_photos(_index(_scene(_ring([0.0, 20, 40, 60, 80]))))}
    # Seen from outside towards the middle, growing angles are to the right.
    assert "right of 080.jpg" in photos["080.jpg"].advice and "left of 000.jpg" in photos["000.jpg"].advice


def test_a_whole_ring_needs_no_more() -> None:
    assert next_photos(_index(_scene(_ring([float(a) for a in range(0, 360, 20)])))) == ()


def test_nobody_is_sent_into_a_wall() -> None:
    cameras = _ring([float(a) for a in range(0, 240, 20)])
    angle = np.radians(245)
    wall = np.array([3 * np.cos(angle), 3 * np.sin(angle), 1.0]) + np.random.default_rng(0).normal(0, 0.1, (80, 3))
    for photo in next_photos(_index(_scene(cameras, wall))):
        assert abs(_angle(photo) - 245) > 5 or photo.reason != "gap"


def test_what_few_photos_see_is_seen_from_another_side() -> None:
    """A patch beside the place, which two neighboring cameras alone see."""
    cameras = _ring([float(a) for a in range(0, 360, 20)], radius=2.0)
    away = np.eye(4)
    away[:3, :3] = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    away[:3, 3] = [2.0, 0.0, 0.0]
    patch = np.array([6.0, 0.0, 0.0]) + np.random.default_rng(1).normal(0, 0.1, size=(150, 3))
    photos = next_photos(_index(_scene([*cameras, PosedCamera(_CAMERA, away, "away.jpg")], patch)))
    assert photos and all(photo.reason == "few_directions" for photo in photos)
    first = photos[0]
    assert first.near == "away.jpg"
    local = (patch.mean(axis=0) - first.camera.world_from_camera[:3, 3]) @ first.camera.world_from_camera[:3, :3]
    assert local[2] > 0 and abs(local[0]) < 0.1 * local[2]


@pytest.mark.parametrize("count", [0, 1])
def test_scenes_of_no_or_one_camera_are_no_error(count: int) -> None:
    photos = next_photos(_index(_scene(_ring([0.0][:count]))))
    assert len(photos) <= 3 and (count or not photos)
