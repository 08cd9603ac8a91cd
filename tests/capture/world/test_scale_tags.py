"""Laws of meters by printed tags: the scale, how sure it is, and when none is stated."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.capture.world.scale_tags import TagSighting, draw_tag, estimate_scale, find_tags
from fastsplat.service.common.progress import silent
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.poses import look_at

F64 = NDArray[np.float64]

_CAMERA = Camera(width=640, height=480, fx=560.0, fy=560.0, cx=320.0, cy=240.0)
_SIDE_M, _UNIT_M = 0.08, 0.37  # a scene unit is 37 cm
_PX_PER_UNIT = 592  # so that a tag is drawn with whole pixels
_TAGS = {560: (-0.3, 0.0), 561: (0.35, 0.2)}
_FEATURES = 1_500  # enough for poses of pictures that are all texture


def _cameras(count: int = 16) -> list[PosedCamera]:
    """On an arc, a meter or so above two tags that lie around the origin; scene units."""
    angles = np.linspace(-2.2, -0.9, count)
    return [
        PosedCamera(
            _CAMERA, look_at((2.6 * np.cos(a), 2.6 * np.sin(a), 1.7 + 0.2 * (n % 3)), (0.05 * (n % 4), 0.0, 0.0))
        )
        for n, a in enumerate(angles)
    ]


def _tag_corners(x: float, y: float, side_m: float = _SIDE_M) -> F64:
    """Clockwise from the top left, as seen from above; scene units."""
    half = side_m / _UNIT_M / 2
    return np.array(
        [[x - half, y + half, 0], [x + half, y + half, 0], [x + half, y - half, 0], [x - half, y - half, 0]]
    )


def _sightings(cameras: list[PosedCamera], noise_px: float = 0.0, seed: int = 0) -> list[TagSighting]:
    rng = np.random.default_rng(seed)
    return [
        TagSighting(view, tag, posed.pixels(corners) + rng.normal(scale=noise_px, size=(4, 2)) if noise_px else
                    posed.pixels(corners))
        for view, posed in enumerate(cameras)
        for tag, corners in ((tag, _tag_corners(*place)) for tag, place in _TAGS.items())
    ]  # fmt: skip


def test_exact_corners_give_the_exact_scale() -> None:
    estimate = estimate_scale(_sightings(_cameras()), _cameras(), _SIDE_M)
    assert estimate is not None
    assert estimate.meters_per_unit == pytest.approx(_UNIT_M, rel=1e-9)
    assert estimate.relative_error_95 < 1e-9


def test_the_interval_holds_in_as_many_cases_as_it_says_and_lengths_err_by_less_than_half_a_percent() -> None:
    """Corners off by 0.3 px, poses by 0.03 degrees and 0.5 mm, which is 0.6 px in pictures; and the printer's error."""
    true, errors, held = _cameras(), [], 0
    draws = 60
    for seed in range(draws):
        rng = np.random.default_rng([7, seed])
        side = _SIDE_M + rng.normal(scale=0.0002)
        cameras = [_disturbed(posed, rng) for posed in true]
        estimate = estimate_scale(_sightings(true, 0.3, seed), cameras, side, 0.0002)
        assert estimate is not None
        errors.append(abs(estimate.meters_per_unit / _UNIT_M - 1))
        held += errors[-1] <= estimate.relative_error_95
    assert held / draws >= 0.95 - 2 * np.sqrt(0.95 * 0.05 / draws)
    assert np.median(errors) < 0.005


def _disturbed(posed: PosedCamera, rng: np.random.Generator) -> PosedCamera:
    pose = posed.world_from_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ cv2.Rodrigues(np.radians(rng.normal(scale=0.03, size=3)))[0]
    pose[:3, 3] += rng.normal(scale=0.0005 / _UNIT_M, size=3)
    return replace(posed, world_from_camera=pose)


def _with_moved(sightings: list[TagSighting], tags: list[int]) -> list[TagSighting]:
    """These tags lie elsewhere in every second view."""
    corners = [posed.pixels(_tag_corners(0.0, -0.4)) for posed in _cameras()]
    moved = [sight.tag in tags and sight.view % 2 for sight in sightings]
    pairs = zip(sightings, moved, strict=True)
    return [replace(sight, corners=corners[sight.view]) if elsewhere else sight for sight, elsewhere in pairs]


def test_too_few_views_contradicting_ones_and_none_state_no_scale() -> None:
    cameras, sightings = _cameras(), _sightings(_cameras())
    assert estimate_scale([], cameras, _SIDE_M) is None
    assert estimate_scale([sight for sight in sightings if sight.view < 2], cameras, _SIDE_M) is None
    assert estimate_scale(_with_moved(sightings, [*_TAGS]), cameras, _SIDE_M) is None
    still = [cameras[0]] * 8
    assert estimate_scale(_sightings(still, 0.3), still, _SIDE_M) is None  # all from one place


def test_a_tag_that_moved_is_left_out_and_the_others_still_tell() -> None:
    estimate = estimate_scale(_with_moved(_sightings(_cameras()), [561]), _cameras(), _SIDE_M)
    assert estimate is not None and estimate.meters_per_unit == pytest.approx(_UNIT_M, rel=1e-9)


def test_a_drawn_tag_is_found_where_it_is_and_once_only() -> None:
    page = np.full((400, 700), 255, np.uint8)
    tag = draw_tag(560, 20)
    page[50:250, 60:260] = tag
    (found,) = find_tags(page, 3, range(560, 587))
    assert (found.view, found.tag) == (3, 560)
    np.testing.assert_allclose(found.corners, [[80, 70], [240, 70], [240, 230], [80, 230]], atol=0.3)
    assert find_tags(page, 3, range(0, 560)) == []
    page[150:350, 400:600] = tag
    assert find_tags(page, 3, range(560, 587)) == []  # which of the two is the one of the other views?


@pytest.fixture(scope="module")
def photos() -> list[NDArray[np.uint8]]:
    """The floor with two tags and a wall behind, both full of texture, from every camera."""
    return [_picture(posed) for posed in _cameras()]


def test_photos_of_tags_give_meters(tmp_path: Path, photos: list[NDArray[np.uint8]]) -> None:
    """By structure from motion, whose world has a scale of its own."""
    capture = _captured(tmp_path, photos, CaptureSettings(sfm_features=_FEATURES))
    scale = capture.report.scale
    assert capture.scale == "METRIC" and scale is not None and scale.source == "tags"
    assert len(capture.views) == len(photos)
    centers = np.stack([view.posed.world_from_camera[:3, 3] for view in capture.views])
    truth = np.stack([posed.world_from_camera[:3, 3] for posed in _cameras()]) * _UNIT_M
    lengths, true = (np.linalg.norm(points[:, None] - points[None], axis=2) for points in (centers, truth))
    far = true > 0.5
    ratio = np.median(lengths[far] / true[far])
    assert abs(ratio - 1) <= min(0.005, max(scale.relative_error_95, 0.002))
    assert scale.relative_error_95 < 0.02


def test_without_tags_of_ours_nothing_is_in_meters(tmp_path: Path, photos: list[NDArray[np.uint8]]) -> None:
    for change in ({"tag_side_m": None}, {"first_tag": 0, "last_tag": 500}):
        settings = CaptureSettings(sfm_features=_FEATURES, **change)
        capture = _captured(tmp_path / str(settings.first_tag), photos[::4], settings, posed=_cameras()[::4])
        assert capture.scale == "ARBITRARY" and capture.report.scale is None


def _captured(
    folder: Path, photos: list[NDArray[np.uint8]], settings: CaptureSettings, posed: list[PosedCamera] | None = None
) -> Capture:
    upload = folder / "upload"
    upload.mkdir(parents=True)
    for number, photo in enumerate(photos):
        Image.fromarray(photo).save(upload / f"{number:02}.png")
    if posed is not None:
        flip = np.diag([1.0, -1.0, -1.0, 1.0])
        frames = [
            {"file_path": f"{number:02}.png", "transform_matrix": (posed_camera.world_from_camera @ flip).tolist()}
            for number, posed_camera in enumerate(posed)
        ]
        camera = {"w": 640, "h": 480, "fl_x": 560.0, "fl_y": 560.0, "cx": 320.0, "cy": 240.0}
        (upload / "transforms.json").write_text(json.dumps({**camera, "frames": frames}))
    return build_capture(validate_upload(upload, settings).folder, folder / "capture", settings, silent)


def _picture(posed: PosedCamera) -> NDArray[np.uint8]:
    """Drawn at three times the size, then averaged, so that edges lie where they are to a small part of a pixel."""
    width, height = 3 * 640, 3 * 480
    picture = np.full((height, width, 3), 90, np.uint8)
    wall, floor = _wall_and_floor()
    size = len(floor)
    corners = np.array([[-1.5, 1.5], [1.5, 1.5], [1.5, -1.5], [-1.5, -1.5]])
    upright = np.stack([corners[:, 0], np.full(4, 0.9), corners[:, 1] + 1.5], axis=1)
    lying = np.concatenate([corners, np.zeros((4, 1))], axis=1)
    for texture, points in ((wall, upright), (floor, lying)):
        source = np.array([[0, 0], [size, 0], [size, size], [0, size]], np.float32) - 0.5
        onto = (3 * posed.pixels(points) - 0.5).astype(np.float32)
        homography = cv2.getPerspectiveTransform(source, onto)
        inside = cv2.warpPerspective(np.full((size, size), 255, np.uint8), homography, (width, height)) > 127
        picture[inside] = cv2.warpPerspective(texture, homography, (width, height))[inside]
    return np.asarray(cv2.resize(picture, (640, 480), interpolation=cv2.INTER_AREA), np.uint8)


@cache
def _wall_and_floor() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Textures, uint8 [S, S, 3], of 3 by 3 units; the tags lie on the floor."""
    rng = np.random.default_rng(5)
    wall, floor = (_texture(rng, 3 * _PX_PER_UNIT) for _ in range(2))
    tag_px = round(_SIDE_M / _UNIT_M * _PX_PER_UNIT * 10 / 8)
    for tag, (x, y) in _TAGS.items():
        drawn = cv2.resize(draw_tag(tag, 40), (tag_px, tag_px), interpolation=cv2.INTER_AREA)
        column, row = round((x + 1.5) * _PX_PER_UNIT - tag_px / 2), round((1.5 - y) * _PX_PER_UNIT - tag_px / 2)
        floor[row : row + tag_px, column : column + tag_px] = drawn[..., None]
    return wall, floor


def _texture(rng: np.random.Generator, size: int) -> NDArray[np.uint8]:
    layers = sum(
        cv2.resize(rng.uniform(0, 255, (cells, cells, 3)), (size, size), interpolation=cv2.INTER_CUBIC) * weight
        for cells, weight in ((30, 0.4), (90, 0.35), (260, 0.25))
    )
    return np.clip(layers, 0, 255).astype(np.uint8)
