"""Laws of cameras and poses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera, PosedCamera

_CAMERA = Camera(640, 480, 500.0, 510.0, 320.0, 240.0)


def _pose(angle: float, shift: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    pose[:3, 3] = [shift, -shift, 2 * shift]
    return pose


@given(st.floats(-7, 7), st.floats(-1e3, 1e3))
def test_a_pose_and_its_inverse_cancel(angle: float, shift: float) -> None:
    posed = PosedCamera(_CAMERA, _pose(angle, shift))
    np.testing.assert_allclose(posed.camera_from_world() @ posed.world_from_camera, np.eye(4), atol=1e-9)


@given(st.integers(1, 4000), st.integers(1, 4000))
def test_a_pixel_keeps_its_ray_when_the_image_is_resized(width: int, height: int) -> None:
    scaled = _CAMERA.scaled_to(width, height)
    x, y = 100.0, 50.0
    u, v = x * width / _CAMERA.width, y * height / _CAMERA.height
    np.testing.assert_allclose(scaled.rays(u, v), _CAMERA.rays(x, y), atol=1e-9)


def test_a_ray_lands_where_it_comes_from() -> None:
    y, x = np.mgrid[0:5, 0:7] * 40.0 + 0.5
    local = _CAMERA.rays(x, y) * 2.5
    assert local.shape == (5, 7, 3) and (local[..., 2] == 2.5).all()
    posed = PosedCamera(_CAMERA, _pose(0.3, 1.0))
    places = posed.places(x, y, np.full(x.shape, 2.5))
    np.testing.assert_allclose(posed.pixels(places), np.stack([x, y], axis=-1))
    behind = posed.world_from_camera[:3, 3] - 2.5 * posed.world_from_camera[:3, 2]
    rows, pixels, depths = posed.in_picture(np.stack([behind, places[3, 2], places[0, 0]]))
    assert rows.tolist() == [1, 2]
    np.testing.assert_allclose(pixels, [[80.5, 120.5], [0.5, 0.5]])
    np.testing.assert_allclose(depths, 2.5)


@pytest.mark.parametrize(
    "damage",
    [
        lambda pose: np.full((4, 4), np.nan),
        lambda pose: np.zeros((4, 4)),
        lambda pose: pose * 2,
        lambda pose: pose @ np.diag([1.0, 1.0, -1.0, 1.0]),
        lambda pose: pose[:3],
    ],
    ids=["nan", "singular", "scaled", "mirrored", "3x4"],
)
def test_a_pose_that_is_not_rigid_is_refused_by_name(damage) -> None:
    with pytest.raises(InvalidInputError, match=r"pose of a\.jpg") as caught:
        PosedCamera(_CAMERA, damage(_pose(0.3, 1.0)), name="a.jpg")
    assert caught.value.field == "pose of a.jpg"


@pytest.mark.parametrize("focal", [0.0, -1.0, float("nan"), float("inf")])
def test_a_focal_length_must_be_a_positive_number(focal: float) -> None:
    with pytest.raises(InvalidInputError):
        Camera(10, 10, focal, 1.0, 5.0, 5.0)
