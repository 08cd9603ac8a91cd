"""Distortion: undone for every camera model, turned with the image, refused when it is none."""

from __future__ import annotations

import cv2
import numpy as np
import pycolmap
import pytest

from fastsplat.service.capture.lens import Lens, check_lens, model_names, turned, turned_pose, undistortion
from fastsplat_contract.errors import InvalidInputError

_W, _H, _F = 320, 240, 260.0
_OPENCV = Lens("OPENCV", _W, _H, (_F, 0.98 * _F, 163.0, 118.0, -0.18, 0.04, 0.002, -0.001))
_FISHEYE = Lens("OPENCV_FISHEYE", _W, _H, (_F, _F, 160.0, 120.0, 0.03, -0.01, 0.0, 0.0))


def _render(lens: Lens, world: object) -> np.ndarray:
    """What the lens sees of a pattern that is a function of the normalised pinhole coordinates."""
    x, y = np.meshgrid(np.arange(lens.width) + 0.5, np.arange(lens.height) + 0.5)
    camera = pycolmap.Camera(model=lens.model, width=lens.width, height=lens.height, params=np.array(lens.params))
    rays = np.asarray(camera.cam_from_img(np.column_stack([x.ravel(), y.ravel()]))).reshape(lens.height, lens.width, 2)
    grey = world(rays[..., 0], rays[..., 1])
    return np.repeat((255 * np.clip(grey, 0, 1)).astype(np.uint8)[..., None], 3, axis=2)


def _waves(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.5 + 0.25 * np.cos(18 * x) + 0.25 * np.cos(15 * y)


@pytest.mark.parametrize("lens", [_OPENCV, _FISHEYE], ids=lambda lens: lens.model)
def test_undistorted_image_is_what_the_pinhole_sees(lens: Lens) -> None:
    way = undistortion(lens, 10_000, field="x")
    seen = way.apply(_render(lens, _waves)).astype(float)
    camera = way.camera
    pinhole = Lens("PINHOLE", camera.width, camera.height, (camera.fx, camera.fy, camera.cx, camera.cy))
    expected = _render(pinhole, _waves).astype(float)
    valid = way.valid(lens.width, lens.height)
    inner = np.ones(seen.shape[:2], bool) if valid is None else cv2.erode(valid.astype(np.uint8), np.ones((5, 5))) > 0
    inner[[0, 1, -1, -2]] = inner[:, [0, 1, -1, -2]] = False
    distorted_error = np.abs(_render(lens, _waves).astype(float) - _render(pinhole.scaled_to(_W, _H), _waves)).mean()
    assert np.abs(seen - expected)[inner].mean() < 1.0 < 0.2 * distorted_error
    assert inner.mean() > 0.9


def test_a_straight_line_becomes_straight() -> None:
    """A dark line of the world: a parabola in the photo, a line in the undistorted image."""

    def line(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 1 - np.exp(-(((y - 0.25 * x - 0.2) / 0.012) ** 2))

    def bend(pixels: np.ndarray) -> float:
        columns = np.arange(20, pixels.shape[1] - 20)
        dark = 255.0 - pixels[:, columns, 0]
        rows = (dark * np.arange(len(pixels))[:, None]).sum(axis=0) / dark.sum(axis=0)
        return float(np.abs(rows - np.polyval(np.polyfit(columns, rows, 1), columns)).max())

    photo = _render(_OPENCV, line)
    assert bend(photo) > 1.5
    assert bend(undistortion(_OPENCV, 10_000, field="x").apply(photo)) < 0.35


@pytest.mark.parametrize("model", sorted(model_names().values()))
def test_every_model_can_be_undistorted(model: str) -> None:
    camera = pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId.__members__[model], _F, _W, _H)
    lens = Lens(model, _W, _H, tuple(camera.params))
    check_lens(lens, field="x")
    way = undistortion(lens, 200, field="x")
    assert lens.is_plain or max(way.camera.width, way.camera.height) <= 200
    assert way.apply(np.zeros((_H, _W, 3), np.uint8)).shape == (way.camera.height, way.camera.width, 3)


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_turning_commutes_with_undistorting(turns: int) -> None:
    photo = _render(_OPENCV, _waves)
    way = undistortion(_OPENCV, 10_000, field="x")
    spun = turned(way, turns, _W, _H)
    np.testing.assert_array_equal(spun.apply(np.rot90(photo, -turns).copy()), np.rot90(way.apply(photo), -turns))


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_a_point_turns_with_the_image(turns: int) -> None:
    way = undistortion(Lens("PINHOLE", _W, _H, (300.0, 310.0, 150.4, 125.3)), 10_000, field="x")
    camera, point = way.camera, np.array([0.1, -0.2, 2.0, 1.0])
    row, column = camera.fy * point[1] / 2 + camera.cy, camera.fx * point[0] / 2 + camera.cx
    image = np.zeros((_H, _W), np.uint8)
    image[int(row), int(column)] = 255
    spun = turned(way, turns, _W, _H).camera
    there = np.linalg.inv(turned_pose(np.eye(4), turns)) @ point
    u, v = spun.fx * there[0] / there[2] + spun.cx, spun.fy * there[1] / there[2] + spun.cy
    assert np.rot90(image, -turns)[int(v), int(u)] == 255
    assert (spun.width, spun.height) == np.rot90(image, -turns).shape[::-1]


def test_labels_never_blend() -> None:
    ids = (np.indices((_H, _W)).sum(axis=0) // 16 % 3 * 500).astype(np.uint16)
    assert set(np.unique(undistortion(_OPENCV, 10_000, field="x").apply_to_ids(ids))) == {0, 500, 1000}


def test_scaling_the_lens_scales_what_it_projects() -> None:
    ray = np.array([[0.2, -0.1, 1.0]])
    full, half = (
        np.asarray(
            pycolmap.Camera(
                model=lens.model, width=lens.width, height=lens.height, params=np.array(lens.params)
            ).img_from_cam(ray)
        )
        for lens in (_OPENCV, _OPENCV.scaled_to(_W // 2, _H // 2))
    )
    np.testing.assert_allclose(half, full / 2)


@pytest.mark.parametrize(
    "lens",
    [
        Lens("NOKIA", _W, _H, (1.0,)),
        Lens("EQUIRECTANGULAR", _W, _H, (_W, _H)),
        Lens("PINHOLE", _W, _H, (_F, _F, 160.0)),
        Lens("PINHOLE", _W, _H, (float("nan"), _F, 160.0, 120.0)),
        Lens("PINHOLE", _W, _H, (0.0, 0.0, 0.0, 0.0)),
        Lens("PINHOLE", _W, _H, (_F, -_F, 160.0, 120.0)),
        Lens("PINHOLE", _W, _H, (_F, _F, 16_000.0, 120.0)),
        Lens("PINHOLE", 0, _H, (_F, _F, 160.0, 120.0)),
        Lens("PINHOLE", 2**63, _H, (_F, _F, 160.0, 120.0)),
        Lens("SIMPLE_RADIAL", _W, _H, (_F, 160.0, 120.0, 1e9)),
    ],
    ids=str,
)
def test_no_lens(lens: Lens) -> None:
    with pytest.raises(InvalidInputError, match="camera 7"):
        check_lens(lens, field="camera 7")


def test_distortion_that_folds_the_image() -> None:
    with pytest.raises(InvalidInputError, match=r"folds|empty"):
        undistortion(Lens("SIMPLE_RADIAL", _W, _H, (_F, 160.0, 120.0, -3.0)), 10_000, field="x")
