"""Distortion: undone for every camera model, rotated with the image, refused when no camera has it."""

from __future__ import annotations

import cv2
import numpy as np
import pycolmap
import pytest

from fastsplat.service.capture.photos.camera_model import (
    CameraModel,
    check_camera_model,
    compute_undistortion,
    model_names,
    rotate90,
    rotate90_pose,
)
from fastsplat.service.common.radial_lens import RadialLens
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera

_W, _H, _F = 320, 240, 260.0
_OPENCV = CameraModel("OPENCV", _W, _H, (_F, 0.98 * _F, 163.0, 118.0, -0.18, 0.04, 0.002, -0.001))
_FISHEYE = CameraModel("OPENCV_FISHEYE", _W, _H, (_F, _F, 160.0, 120.0, 0.03, -0.01, 0.0, 0.0))


def _colmap(camera_model: CameraModel) -> pycolmap.Camera:
    size = {"width": camera_model.width, "height": camera_model.height}
    return pycolmap.Camera(model=camera_model.model, params=np.array(camera_model.params), **size)


def _render(camera_model: CameraModel, world: object) -> np.ndarray:
    """What the camera sees of a pattern that is a function of the normalized pinhole coordinates."""
    width, height = camera_model.width, camera_model.height
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.asarray(_colmap(camera_model).cam_from_img(np.column_stack([x.ravel(), y.ravel()])))
    rays = rays.reshape(height, width, 2)
    gray = world(rays[..., 0], rays[..., 1])
    return np.repeat((255 * np.clip(gray, 0, 1)).astype(np.uint8)[..., None], 3, axis=2)


def _waves(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.5 + 0.25 * np.cos(18 * x) + 0.25 * np.cos(15 * y)


@pytest.mark.parametrize("camera_model", [_OPENCV, _FISHEYE], ids=lambda camera_model: camera_model.model)
def test_undistorted_image_is_what_the_pinhole_sees(camera_model: CameraModel) -> None:
    undistortion = compute_undistortion(camera_model, 10_000, field="x")
    undistorted = undistortion.apply(_render(camera_model, _waves)).astype(float)
    camera = undistortion.camera
    pinhole = CameraModel("PINHOLE", camera.width, camera.height, (camera.fx, camera.fy, camera.cx, camera.cy))
    expected = _render(pinhole, _waves).astype(float)
    valid = undistortion.valid(camera_model.width, camera_model.height)
    inner = (
        np.ones(undistorted.shape[:2], bool)
        if valid is None
        else cv2.erode(valid.astype(np.uint8), np.ones((5, 5))) > 0
    )
    inner[[0, 1, -1, -2]] = inner[:, [0, 1, -1, -2]] = False
    distorted_error = np.abs(
        _render(camera_model, _waves).astype(float) - _render(pinhole.scaled_to(_W, _H), _waves)
    ).mean()
    assert np.abs(undistorted - expected)[inner].mean() < 1.0 < 0.2 * distorted_error
    assert inner.mean() > 0.9


@pytest.mark.parametrize("turns", [0, 1])
def test_the_lens_is_told_by_two_numbers_where_they_say_it(turns: int) -> None:
    def lens(model: str, *params: float) -> RadialLens | None:
        undistortion = compute_undistortion(CameraModel(model, _W, _H, params), 10_000, field="x")
        return rotate90(undistortion, turns, _W, _H).lens

    assert lens("SIMPLE_PINHOLE", _F, 160.0, 120.0) == RadialLens(pytest.approx(_F / _W), pytest.approx(0.0, abs=1e-9))
    for k1 in (-0.1, 0.03):
        expected = RadialLens(pytest.approx(_F / _W), pytest.approx(k1))
        assert lens("SIMPLE_RADIAL", _F, 160.0, 120.0, k1) == expected
    two = lens("RADIAL", _F, 160.0, 120.0, -0.1, 0.02)
    assert two is not None and two.k1 == pytest.approx(-0.1, abs=0.02)
    assert lens("RADIAL", _F, 160.0, 120.0, -0.3, 0.5) is None
    assert lens("PINHOLE", _F, 0.9 * _F, 160.0, 120.0) is None


@pytest.mark.parametrize("model", sorted(model_names().values()))
def test_every_model_can_be_undistorted(model: str) -> None:
    params = pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId.__members__[model], _F, _W, _H).params
    camera_model = CameraModel(model, _W, _H, tuple(params))
    check_camera_model(camera_model, field="x")
    undistortion = compute_undistortion(camera_model, 200, field="x")
    assert not camera_model.has_distortion or max(undistortion.camera.width, undistortion.camera.height) <= 200
    assert undistortion.apply(np.zeros((_H, _W, 3), np.uint8)).shape == (
        undistortion.camera.height,
        undistortion.camera.width,
        3,
    )


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_rotation_commutes_with_undistortion(turns: int) -> None:
    photo = _render(_OPENCV, _waves)
    undistortion = compute_undistortion(_OPENCV, 10_000, field="x")
    rotated = rotate90(undistortion, turns, _W, _H)
    np.testing.assert_array_equal(
        rotated.apply(np.rot90(photo, -turns).copy()), np.rot90(undistortion.apply(photo), -turns)
    )


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_a_point_rotates_with_the_image(turns: int) -> None:
    undistortion = compute_undistortion(CameraModel("PINHOLE", _W, _H, (300.0, 310.0, 150.4, 125.3)), 10_000, field="x")
    point = np.array([0.1, -0.2, 2.0])
    column, row = PosedCamera(undistortion.camera, np.eye(4)).pixels(point)
    image = np.zeros((_H, _W), np.uint8)
    image[int(row), int(column)] = 255
    rotated = rotate90(undistortion, turns, _W, _H).camera
    u, v = PosedCamera(rotated, rotate90_pose(np.eye(4), turns)).pixels(point)
    assert np.rot90(image, -turns)[int(v), int(u)] == 255
    assert (rotated.width, rotated.height) == np.rot90(image, -turns).shape[::-1]


def test_labels_never_blend() -> None:
    ids = (np.indices((_H, _W)).sum(axis=0) // 16 % 3 * 500).astype(np.uint16)
    assert set(np.unique(compute_undistortion(_OPENCV, 10_000, field="x").apply_to_ids(ids))) == {0, 500, 1000}


def test_scaling_the_camera_scales_what_it_projects() -> None:
    ray = np.array([[0.2, -0.1, 1.0]])
    models = (_OPENCV, _OPENCV.scaled_to(_W // 2, _H // 2))
    full, half = (np.asarray(_colmap(camera_model).img_from_cam(ray)) for camera_model in models)
    np.testing.assert_allclose(half, full / 2)


@pytest.mark.parametrize(
    "camera_model",
    [
        CameraModel("NOKIA", _W, _H, (1.0,)),
        CameraModel("EQUIRECTANGULAR", _W, _H, (_W, _H)),
        CameraModel("PINHOLE", _W, _H, (_F, _F, 160.0)),
        CameraModel("PINHOLE", _W, _H, (float("nan"), _F, 160.0, 120.0)),
        CameraModel("PINHOLE", _W, _H, (0.0, 0.0, 0.0, 0.0)),
        CameraModel("PINHOLE", _W, _H, (_F, -_F, 160.0, 120.0)),
        CameraModel("PINHOLE", _W, _H, (_F, _F, 16_000.0, 120.0)),
        CameraModel("PINHOLE", 0, _H, (_F, _F, 160.0, 120.0)),
        CameraModel("PINHOLE", 2**63, _H, (_F, _F, 160.0, 120.0)),
        CameraModel("SIMPLE_RADIAL", _W, _H, (_F, 160.0, 120.0, 1e9)),
    ],
    ids=str,
)
def test_impossible_cameras_are_refused(camera_model: CameraModel) -> None:
    with pytest.raises(InvalidInputError, match="camera 7"):
        check_camera_model(camera_model, field="camera 7")


def test_distortion_that_folds_the_image() -> None:
    with pytest.raises(InvalidInputError, match=r"folds|empty"):
        compute_undistortion(CameraModel("SIMPLE_RADIAL", _W, _H, (_F, 160.0, 120.0, -3.0)), 10_000, field="x")
