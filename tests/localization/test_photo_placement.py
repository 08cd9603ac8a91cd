"""A picture of a scene finds its place in it again, whatever its exposure; one of another scene finds none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fastsplat.service.common.radial_lens import RadialLens
from fastsplat.service.localization.landmarks import Landmarks, find_landmarks
from fastsplat.service.localization.photo_placement import Photo, PlacedPhoto, place_photos
from fastsplat.service.query.drawing.scene_renderer import Renderer
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.splatting.exposure.photometric import correct
from fastsplat_contract.geometry.camera import PosedCamera
from tests.localization.textured_room import CAMERA, looking, renderer, textured_room, through_lens

_FOCAL = CAMERA.fx / CAMERA.width
_BETWEEN = looking(0.11, height=1.15, away=2.45)


@pytest.fixture(scope="module")
def room() -> Scene:
    return textured_room()


@pytest.fixture(scope="module")
def drawn(room: Scene) -> Renderer:
    return renderer(room)


@pytest.fixture(scope="module")
def landmarks(room: Scene, drawn: Renderer) -> Landmarks:
    return landmarks_of(room, drawn)


def landmarks_of(scene: Scene, drawn: Renderer) -> Landmarks:
    """Of the scene's own pictures, in place of photos."""
    photos = [(posed, lambda posed=posed: drawn.colors(posed)) for posed in scene.cameras]
    return find_landmarks(photos, drawn.geometry)


def _place(
    picture: NDArray[np.uint8], landmarks: Landmarks, drawn: Renderer, focal: float | None = None
) -> PlacedPhoto:
    (placed,) = place_photos([Photo(picture, focal)], landmarks, drawn.geometry)
    return placed


def _assert_near(placed: PlacedPhoto, truth: PosedCamera, size: float, *, percent: float, degrees: float) -> None:
    """Off by less than a share of the scene's size, and by less than an angle."""
    assert placed.posed is not None, placed
    off = np.linalg.norm(placed.posed.world_from_camera[:3, 3] - truth.world_from_camera[:3, 3])
    turn = placed.posed.world_from_camera[:3, :3] @ truth.world_from_camera[:3, :3].T
    assert 100 * off / size < percent
    assert np.degrees(Rotation.from_matrix(turn).magnitude()) < degrees


@pytest.mark.parametrize("focal", [_FOCAL, None])
def test_a_picture_of_the_scene_comes_back_to_its_place(
    landmarks: Landmarks, drawn: Renderer, focal: float | None
) -> None:
    placed = _place(drawn.colors(_BETWEEN), landmarks, drawn, focal)
    _assert_near(placed, _BETWEEN, landmarks.size, percent=0.2, degrees=0.1)
    assert placed.focal_source == ("given" if focal else "scene")
    assert placed.comparison is not None


def test_a_lens_that_the_scene_has_not_seen_is_found_out(landmarks: Landmarks, drawn: Renderer) -> None:
    zoomed = replace(looking(0.05), camera=replace(CAMERA, fx=640.0, fy=640.0))
    placed = _place(drawn.colors(zoomed), landmarks, drawn)
    _assert_near(placed, zoomed, landmarks.size, percent=2, degrees=0.5)
    assert placed.focal_source == "estimated" and placed.posed is not None
    assert placed.posed.camera.fx == pytest.approx(640, rel=0.02)


def test_the_lens_of_the_scenes_photos_is_undone_and_believed_only_where_it_fits(
    landmarks: Landmarks, drawn: Renderer
) -> None:
    picture = drawn.colors(_BETWEEN)
    known = replace(landmarks, lens=RadialLens(_FOCAL, 0.2))
    placed = _place(through_lens(picture, 0.2), known, drawn)
    _assert_near(placed, _BETWEEN, landmarks.size, percent=0.2, degrees=0.1)
    assert (placed.focal_source, placed.radial) == ("scene", 0.2)
    assert placed.posed is not None and placed.posed.camera.fx == pytest.approx(CAMERA.fx)
    assert placed.comparison is not None

    straight = _place(picture, known, drawn)
    assert abs(straight.radial) < 0.02
    placement = _place(through_lens(picture, 0.2), landmarks, drawn)
    assert placement.radial == pytest.approx(0.2, abs=0.05)
    for found in (straight, placement):
        _assert_near(found, _BETWEEN, landmarks.size, percent=1, degrees=0.3)


@pytest.mark.parametrize("correction", [(-1.5, 0.0, 0.0), (0.7, 0.0, 0.0), (0.0, 0.4, -0.4)])
def test_exposure_and_white_balance_change_nothing(
    landmarks: Landmarks, drawn: Renderer, correction: tuple[float, float, float]
) -> None:
    picture = drawn.colors(_BETWEEN)
    exposed = correct(torch.from_numpy(picture.astype(np.float32) / 255), torch.tensor(correction)).clamp(0, 1)
    placed = _place((exposed.numpy() * 255).round().astype(np.uint8), landmarks, drawn)
    _assert_near(placed, _BETWEEN, landmarks.size, percent=0.3, degrees=0.15)
    assert placed.comparison is not None


def test_another_room_and_an_empty_picture_are_refused(landmarks: Landmarks, drawn: Renderer) -> None:
    elsewhere = renderer(textured_room(seed=1))
    for angle in (-0.3, 0.0, 0.3):
        placed = _place(elsewhere.colors(looking(angle)), landmarks, drawn)
        assert placed.refusal in ("few_matches", "narrow", "looks_different")
        assert placed.posed is placed.covariance is placed.comparison is None
    assert _place(np.full((360, 480, 3), 128, np.uint8), landmarks, drawn).refusal == "no_keypoints"


def test_a_match_without_the_scene_around_it_is_refused(landmarks: Landmarks, drawn: Renderer) -> None:
    """A poster of the room in another room has its keypoints, and its picture around them does not agree."""
    picture = renderer(textured_room(seed=1)).colors(_BETWEEN)
    picture[120:240, 160:320] = drawn.colors(_BETWEEN)[120:240, 160:320]
    placed = _place(picture, landmarks, drawn, _FOCAL)
    assert placed.refusal == "looks_different" and placed.evidence.inliers > 15


def test_the_frame_of_the_scene_changes_nothing(room: Scene, landmarks: Landmarks, drawn: Renderer) -> None:
    turn = Rotation.from_euler("xyz", [0.4, -1.1, 2.0]).as_matrix()
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn, [5.0, -3.0, 1.0]
    gaussians = replace(room.gaussians, means=(room.gaussians.means @ turn.T + motion[:3, 3]).astype(np.float32))
    cameras = tuple(replace(posed, world_from_camera=motion @ posed.world_from_camera) for posed in room.cameras)
    moved = replace(room, gaussians=gaussians, cameras=cameras)
    there = renderer(moved)
    placed = _place(drawn.colors(_BETWEEN), landmarks_of(moved, there), there, _FOCAL)
    truth = replace(_BETWEEN, world_from_camera=motion @ _BETWEEN.world_from_camera)
    _assert_near(placed, truth, landmarks.size, percent=0.2, degrees=0.1)


def test_photos_that_know_of_each_other_find_their_place_together(landmarks: Landmarks, drawn: Renderer) -> None:
    """The second one shows too little by itself."""
    poses = [_BETWEEN, looking(-0.15, height=1.2)]
    first, second = (drawn.colors(posed) for posed in poses)
    second = second[156:204, 216:264]
    rough = [np.linalg.inv(poses[0].world_from_camera) @ posed.world_from_camera for posed in poses]
    rough[1] = rough[1].copy()
    rough[1][:3, 3] += 0.01
    photos = [Photo(first, _FOCAL), Photo(second, CAMERA.fx / 48)]
    assert place_photos(photos[1:], landmarks, drawn.geometry)[0].refusal is not None
    together = place_photos(photos, landmarks, drawn.geometry, rough)
    for placed, posed in zip(together, poses, strict=True):
        _assert_near(placed, posed, landmarks.size, percent=1, degrees=0.5)
