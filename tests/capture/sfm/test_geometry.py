"""What makes a reconstruction trustworthy, which pairs are matched, and the frame it is put into."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fastsplat.service.capture.photos.video import sharpest_per_interval
from fastsplat.service.capture.sfm.geometry import (
    Reconstruction,
    contradictions,
    depths,
    epipolar_error_px,
    normalize_world,
    refuse_wrong_poses,
    repetition_warning,
    validate_reconstruction,
    widest_angle_deg,
)
from fastsplat.service.capture.sfm.pairs import choose_pairs, probe_scores, probes
from fastsplat_contract.errors import ReconstructionError
from fastsplat_contract.geometry.poses import look_at


def _ring(count: int = 8, radius: float = 3.0) -> np.ndarray:
    """Cameras on a circle that look at the origin, y down."""
    poses = []
    for angle in np.linspace(0, 2, count):
        center = radius * np.array([np.cos(angle), np.sin(angle), 0.3])
        poses.append(look_at(center, (0, 0, 0)))
    return np.array(poses)


def _reconstruction(**changes: object) -> Reconstruction:
    points = np.random.default_rng(0).normal(size=(400, 3)) * 0.5
    values = {
        "world_from_camera": _ring(),
        "points": points,
        "angles_deg": np.full(400, 20.0),
        "images": 8,
        "models": (8,),
    }
    return Reconstruction(**{**values, **changes})


def _validate(reconstruction: Reconstruction) -> list[str]:
    return validate_reconstruction(reconstruction, min_points=50, min_registered_share=0.2)


def test_a_split_and_missing_images_alone_give_warnings() -> None:
    assert _validate(_reconstruction()) == []
    warnings = _validate(_reconstruction(images=14, models=(8, 4)))
    assert len(warnings) == 2 and "8, 4" in warnings[0] and "8 of 14" in warnings[1]


_STILL = _ring()
_STILL[:, :3, 3] = _STILL[0, :3, 3] + np.linspace(0, 1e-3, 8)[:, None]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"images": 100}, "8 of 100"),
        ({"points": np.zeros((10, 3)), "angles_deg": np.full(10, 20.0)}, "10 points"),
        ({"angles_deg": np.full(400, 0.3)}, "hardly moved"),
        ({"world_from_camera": _STILL}, "hardly moved"),
        ({"points": _reconstruction().points * [1, 1, 1e-6]}, "plane"),
        ({"points": _reconstruction().points * [1, 1e-6, 1e-6]}, "plane"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_degenerate_geometry_is_refused(changes: dict[str, object], said: str) -> None:
    with pytest.raises(ReconstructionError, match=said) as caught:
        _validate(_reconstruction(**changes))
    assert caught.value.hint


def test_depth_and_angle() -> None:
    poses = _ring()
    np.testing.assert_allclose(depths(poses, np.zeros((1, 3)))[:, 0], np.linalg.norm(poses[:, :3, 3], axis=1))
    assert widest_angle_deg(np.array([[1.0, 0, 0], [0, 2.0, 0], [1.0, 1.0, 0]]), np.zeros(3)) == pytest.approx(90)


def test_epipolar_error_is_a_distance_in_pixels() -> None:
    """Zero for true matches; about d / √2 (Sampson shares it between the images) when one is d pixels off its line."""
    first, second = _ring()[[0, 3]]
    points = _reconstruction().points
    rays = []
    for pose in (first, second):
        there = np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(pose).T
        rays.append(there[:, :2] / there[:, 2:3])
    relative = np.linalg.inv(second) @ first
    assert epipolar_error_px(*rays, relative, 800.0).max() < 1e-9
    shifted = rays[1] + [0, 10 / 800]
    errors = epipolar_error_px(rays[0], shifted, relative, 800.0)
    assert 4 < np.median(errors) < 10


def test_pairs_that_contradict() -> None:
    assert contradictions([100] * 20 + [10] * 5, [1.0] * 15 + [50.0] * 4 + [float("nan")] + [50.0] * 5) == (5, 20)
    assert contradictions([], []) == (0, 0)
    assert repetition_warning(2, 20) == repetition_warning(0, 0) == []
    assert "5 of 20" in repetition_warning(5, 20)[0]
    refuse_wrong_poses(5, 20)
    refuse_wrong_poses(0, 0)
    with pytest.raises(ReconstructionError, match="12 of 20"):
        refuse_wrong_poses(12, 20)


@given(
    count=st.integers(2, 40),
    best=st.integers(1, 8),
    exhaustive=st.integers(2, 40),
    ordered=st.booleans(),
    seed=st.integers(0, 99),
)
@hypothesis_settings(max_examples=60)
def test_pairs_to_match(count: int, best: int, exhaustive: int, ordered: bool, seed: int) -> None:
    upper = np.triu(np.random.default_rng(seed).integers(0, 50, (count, count)), 1).astype(np.int32)
    scores = upper + upper.T
    pairs = choose_pairs(scores, exhaustive_images=exhaustive, pairs_per_image=best, ordered=ordered)
    assert pairs == sorted(set(pairs))
    assert all(0 <= i < j < count for i, j in pairs)
    assert {(i, i + 1) for i in range(count - 1)} <= set(pairs)
    if count <= exhaustive:
        assert len(pairs) == count * (count - 1) // 2
    else:
        assert len(pairs) <= count * (best + 9)
        for i in range(count):
            j = int(np.argmax(scores[i]))
            assert scores[i, j] == 0 or (min(i, j), max(i, j)) in pairs


def test_probes_of_the_same_object_score_high() -> None:
    rng = np.random.default_rng(2)
    obj, other_object = rng.integers(0, 255, (2, 300, 128), dtype=np.uint8)
    again = np.clip(obj.astype(int) + rng.integers(-9, 9, obj.shape), 0, 255).astype(np.uint8)
    scores = probe_scores([probes(descriptors) for descriptors in (obj, again, other_object)])
    assert scores[0, 1] > 250 and scores[0, 2] < 10
    assert (scores == scores.T).all()
    assert len(probes(rng.integers(0, 255, (2000, 128), dtype=np.uint8))) == 256


def test_normalizing_the_world_is_one_similarity() -> None:
    """Distances keep their ratios, what is projected stays, the scene is centred, sized and upright."""
    rotation, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    rotation *= np.linalg.det(rotation)
    poses, points = _ring(), _reconstruction().points + 0.1
    wild = poses.copy()
    wild[:, :3, :3] = rotation @ poses[:, :3, :3]
    wild[:, :3, 3] = 17 * poses[:, :3, 3] @ rotation.T + 5
    wild_points = 17 * points @ rotation.T + 5
    normalized, normalized_points = normalize_world(wild, wild_points)
    before, after = depths(wild, wild_points), depths(normalized, normalized_points)
    np.testing.assert_allclose(after / before, (after / before)[0, 0])
    np.testing.assert_allclose(
        normalized[:, :3, :3] @ normalized[:, :3, :3].transpose(0, 2, 1), np.eye(3)[None].repeat(8, 0), atol=1e-9
    )
    np.testing.assert_allclose(np.median(np.linalg.norm(normalized[:, :3, 3], axis=1)), 3.0, rtol=0.1)
    np.testing.assert_allclose(normalized[:, 2, 0], 0, atol=1e-9)  # horizons are level, from wherever photos were taken
    assert (-normalized[:, 2, 1] > 0.5).all()


@given(st.integers(0, 10_000))
def test_the_upright_rotation_is_the_smallest(seed: int) -> None:
    """As scipy computes it from one pair of vectors."""
    up = Rotation.random(rng=seed).as_matrix()[:, 1] * [1, 1, seed % 2 or 1e-7]
    up /= np.linalg.norm(up)
    poses = np.eye(4)[None].repeat(3, axis=0)
    poses[:, :3, :3] = Rotation.align_vectors([-up], [[0.0, 1.0, 0.0]])[0].as_matrix()
    poses[:, :3, 3] = np.eye(3)
    normalized, _ = normalize_world(poses, np.zeros((1, 3)))
    applied = normalized[0, :3, :3] @ poses[0, :3, :3].T
    expected, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])
    np.testing.assert_allclose(applied, expected.as_matrix(), atol=1e-9)


def test_cameras_upside_down_are_turned() -> None:
    poses = np.eye(4)[None].repeat(3, axis=0)
    poses[:, :3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # image down is world up
    poses[:, :3, 3] = np.eye(3)
    normalized, _ = normalize_world(poses, np.zeros((1, 3)))
    np.testing.assert_allclose(-normalized[:, :3, 1], [[0, 0, 1]] * 3, atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(normalized[:, :3, :3]), 1)


@given(st.integers(2, 200), st.integers(1, 90))
def test_sharpest_frames_are_spread(frames: int, intervals: int) -> None:
    sharpness = np.random.default_rng(frames).random(frames)
    numbers = sharpest_per_interval(sharpness, intervals)
    assert len(numbers) == min(frames, intervals)
    assert int(np.argmax(sharpness)) in numbers
