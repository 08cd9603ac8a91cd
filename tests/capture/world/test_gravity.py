"""Which way is up, and how sure that is: sensors, level cameras and level planes against the truth."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from PIL import ExifTags
from scipy.spatial.transform import Rotation

from fastsplat.service.capture.formats.image_io import PhotoInfo, apply_orientation
from fastsplat.service.capture.photos.photo_metadata import up_of_exif
from fastsplat.service.capture.world.gravity import vertical_of_capture
from tests.capture import made_room


def _turned(degrees: float, axis: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(degrees * axis / np.linalg.norm(axis), degrees=True).as_matrix()


def _held(rng: np.random.Generator, count: int, roll_deg: float) -> np.ndarray:
    """Cameras around a room, held level but for a roll."""
    places = rng.uniform([-1.5, -1.2, 1.0], [1.5, 1.2, 1.8], (count, 3))
    headings, pitches = rng.uniform(0, 360, count), rng.uniform(-40, 10, count)
    rolls = rng.normal(0, roll_deg, count)
    return np.array(
        [made_room.pose(tuple(p), *angles) for p, *angles in zip(places, headings, pitches, rolls, strict=True)]
    )


def _room_points(rng: np.random.Generator, planes: bool = True) -> np.ndarray:
    """Points on floor, table and walls, some millimeters off, and clutter."""
    floor = np.column_stack([rng.uniform(-2, 2, (700, 2)), np.zeros(700)])
    table = np.column_stack([rng.uniform(-0.6, 0.6, (500, 2)), np.full(500, 0.7)])
    wall = np.column_stack([rng.uniform(-2, 2, 600), np.full(600, 2.0), rng.uniform(0, 2.4, 600)])
    clutter = rng.uniform([-2, -2, 0], [2, 2, 2], (1_200, 3))
    return np.concatenate([floor, table, wall, clutter] if planes else [clutter]) + rng.normal(
        0, 0.002, (3_000 if planes else 1_200, 3)
    )


def _error(up: np.ndarray, truth: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(up @ truth, -1, 1))))


@pytest.mark.parametrize("roll_deg", [0.5, 4.0])
def test_the_error_is_as_large_as_stated(roll_deg: float) -> None:
    """By level cameras alone: |error| / σ is Rayleigh distributed, 63 % within √2 and nearly all within 3."""
    ratios = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        poses = _held(rng, 14, roll_deg)
        vertical = vertical_of_capture(poses, _room_points(rng, planes=False), [])
        assert vertical is not None and vertical.estimate.source == "horizon"
        ratios.append(_error(vertical.up, np.array([0.0, 0.0, 1.0])) / vertical.estimate.deviation_deg)
    assert np.mean(np.array(ratios) < np.sqrt(2)) > 0.5 and max(ratios) < 4


def test_level_planes_make_it_better() -> None:
    """Cameras that were held badly say it to degrees, floor and table to tenths; whatever the world's own axes are."""
    truth = _turned(70, np.array([1.0, 2.0, -0.5]))
    with_planes, without = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        poses = _held(rng, 10, 5.0)
        poses[:, :3] = np.einsum("ij,njk->nik", truth, poses[:, :3])
        for planes, errors in ((True, with_planes), (False, without)):
            vertical = vertical_of_capture(poses, _room_points(rng, planes) @ truth.T, [])
            assert vertical is not None and vertical.estimate.source == ("planes" if planes else "horizon")
            errors.append(_error(vertical.up, truth[:, 2]))
            assert errors[-1] < 4 * vertical.estimate.deviation_deg
    assert np.median(with_planes) < 0.3 < np.median(without)


def test_planes_that_contradict_the_cameras_are_not_believed() -> None:
    rng = np.random.default_rng(3)
    slope = _room_points(rng) @ _turned(12, np.array([1.0, 0.0, 0.0])).T
    vertical = vertical_of_capture(_held(rng, 20, 0.5), slope, [])
    assert vertical is not None and vertical.estimate.source == "horizon"
    assert _error(vertical.up, np.array([0.0, 0.0, 1.0])) < 1


def test_sensors_say_it_where_cameras_do_not() -> None:
    """All photos at one heading and rolled: the cameras' axes cannot tell; every photo's own vertical can."""
    rng = np.random.default_rng(0)
    poses = np.array([made_room.pose((0.1 * i, 0, 1.4), 10, -20, 25) for i in range(12)])
    truth = np.array([0.0, 0.0, 1.0])
    ups = [_turned(rng.normal(0, 1.0), rng.normal(size=3)) @ truth for _ in poses]
    ups[3] = np.array([1.0, 0.0, 0.0])  # a phone that was shaken
    clutter = _room_points(rng, planes=False)
    without, vertical = vertical_of_capture(poses, clutter, []), vertical_of_capture(poses, clutter, ups)
    assert without is not None and without.estimate.source == "cameras" and without.estimate.deviation_deg >= 10
    assert vertical is not None and vertical.estimate.source == "metadata"
    assert _error(vertical.up, truth) < 1 < 10 < _error(without.up, truth) and vertical.estimate.deviation_deg < 1.5
    scattered = [_turned(90 * i, np.array([1.0, 0.3, 0.0])) @ truth for i in range(12)]
    disagreeing = vertical_of_capture(poses, clutter, scattered)
    assert disagreeing is not None and disagreeing.estimate.source == "cameras"


def _maker_note(
    left: float, bottom: float, face: float, kind: int = 10, number: int = 3, offset: int | None = None
) -> bytes:
    head = b"Apple iOS\0\0\x01MM" + struct.pack(">H", 1)
    at = len(head) + 12 if offset is None else offset
    numbers = [part for value in (left, bottom, face) for part in (round(value * 10_000), 10_000)]
    return head + struct.pack(">HHII", 8, kind, number, at) + struct.pack(">6i", *numbers)


@pytest.mark.parametrize(
    ("orientation", "vector"),
    [
        (6, (0.0, -1.0, 0.0)),  # in portrait: up is away from the phone's bottom
        (1, (-1.0, 0.0, 0.0)),  # lying on its right side in portrait terms, stored as it is
        (3, (1.0, 0.0, 0.0)),
        (8, (0.0, 1.0, 0.0)),
    ],
)
def test_an_upright_photo_has_up_above(orientation: int, vector: tuple[float, float, float]) -> None:
    photo = PhotoInfo("a.jpg", 40, 30, orientation, "Apple/iPhone/26", 26.0)
    up = up_of_exif({ExifTags.Base.MakerNote: _maker_note(*vector)}, photo)
    np.testing.assert_allclose(up, (0, -1, 0), atol=1e-9)
    assert apply_orientation(np.zeros((30, 40), np.uint8), orientation).shape == photo.upright_size[::-1]
    down = up_of_exif({ExifTags.Base.MakerNote: _maker_note(0, 0, -0.99)}, photo)
    np.testing.assert_allclose(down, (0, 0, -1), atol=1e-9, err_msg="a phone that looks down has up behind it")


@pytest.mark.parametrize(
    "note",
    [
        b"",
        b"Apple iOS\0\0\x01MM",
        b"Apple iOS\0\0\x01MM" + b"\xff" * 4_000,
        _maker_note(0, -1, 0, kind=5),
        _maker_note(0, -1, 0, number=2**31),
        _maker_note(0, -1, 0, offset=2**32 - 8),
        _maker_note(0, -3, 0),
        _maker_note(0, -1, 0)[:-4],
        _maker_note(0, -1, 0).replace(struct.pack(">i", 10_000), struct.pack(">i", 0)),
        "Apple iOS",
    ],
)
def test_maker_notes_that_cannot_be_say_nothing(note: object) -> None:
    photo = PhotoInfo("a.jpg", 40, 30, 1, "Apple/iPhone/26", 26.0)
    assert up_of_exif({ExifTags.Base.MakerNote: note}, photo) is None
    front = {ExifTags.Base.MakerNote: _maker_note(0, -1, 0), ExifTags.Base.LensModel: "iPhone front camera"}
    assert up_of_exif(front, photo) is None, "it looks the other way"
