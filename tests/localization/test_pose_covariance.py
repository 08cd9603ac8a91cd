"""The covariance of a pose holds the truth, shrinks with more matches, and turns with the world."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from fastsplat.service.localization.matching import Matches
from fastsplat.service.localization.pose_solving import SolvedPose, pinhole, pose_covariance, refine_pose, solve_pose
from fastsplat_contract.geometry.camera import PosedCamera

_NOISE_PX = 0.8


def _posed(focal: float = 600.0) -> PosedCamera:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.2, 0.5]).as_matrix()
    pose[:3, 3] = [1.0, -2.0, 0.5]
    return PosedCamera(pinhole((800, 600), focal), pose)


def _points(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    local = np.stack([rng.uniform(-2, 2, count), rng.uniform(-1.5, 1.5, count), rng.uniform(3, 8, count)], axis=1)
    pose = _posed().world_from_camera
    return local @ pose[:3, :3].T + pose[:3, 3]


def _error(posed: PosedCamera) -> np.ndarray:
    truth, found = _posed().world_from_camera, posed.world_from_camera
    turn = Rotation.from_matrix(found[:3, :3] @ truth[:3, :3].T).as_rotvec()
    return np.concatenate([found[:3, 3] - truth[:3, 3], turn])


@pytest.mark.parametrize("estimated", [False, True])
def test_the_truth_is_inside_in_at_least_as_many_cases_as_is_said(estimated: bool) -> None:
    inside, count = 0, 60
    points = _points(120, 0)
    for seed in range(count):
        pixels = _posed().pixels(points) + np.random.default_rng(seed).normal(scale=_NOISE_PX, size=(120, 2))
        rows = np.arange(120)
        start = SolvedPose(_posed(), rows, 120, "estimated" if estimated else "given")
        found = refine_pose(pixels, points, Matches(rows, rows), start)
        assert found is not None
        covariance = pose_covariance(found.posed, pixels, points, focal_estimated=estimated)
        error = _error(found.posed)
        inside += error @ np.linalg.solve(covariance, error) <= chi2.ppf(0.95, 6)
    assert inside >= 0.93 * count


def test_four_times_as_many_matches_halve_the_deviations() -> None:
    def deviations(count: int) -> np.ndarray:
        points = _points(count, 1)
        pixels = _posed().pixels(points) + np.random.default_rng(2).normal(scale=_NOISE_PX, size=(count, 2))
        return np.sqrt(np.diag(pose_covariance(_posed(), pixels, points, focal_estimated=False)))

    np.testing.assert_allclose(deviations(400) / deviations(1600), 2.0, rtol=0.25)


def test_an_unknown_focal_length_makes_a_pose_less_sure() -> None:
    points = _points(200, 3)
    pixels = _posed().pixels(points) + np.random.default_rng(4).normal(scale=_NOISE_PX, size=(200, 2))
    known, unknown = (pose_covariance(_posed(), pixels, points, focal_estimated=flag) for flag in (False, True))
    assert (np.linalg.eigvalsh(unknown - known) >= -1e-12).all() and np.trace(unknown) > 1.5 * np.trace(known)


def test_it_turns_with_the_world() -> None:
    points = _points(100, 5)
    pixels = _posed().pixels(points) + np.random.default_rng(6).normal(scale=_NOISE_PX, size=(100, 2))
    turn = Rotation.from_euler("xyz", [1.0, 0.2, -0.7]).as_matrix()
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn, [3.0, 1.0, -2.0]
    moved = PosedCamera(_posed().camera, motion @ _posed().world_from_camera)
    there = pose_covariance(moved, pixels, points @ turn.T + motion[:3, 3], focal_estimated=False)
    here = pose_covariance(_posed(), pixels, points, focal_estimated=False)
    both = np.block([[turn, np.zeros((3, 3))], [np.zeros((3, 3)), turn]])
    np.testing.assert_allclose(there, both @ here @ both.T, rtol=1e-6, atol=1e-14)


def test_outliers_do_not_move_the_pose() -> None:
    points, rng = _points(150, 7), np.random.default_rng(8)
    pixels = _posed().pixels(points) + rng.normal(scale=_NOISE_PX, size=(150, 2))
    wrong = rng.permutation(150)[:90]
    pixels[wrong] = rng.uniform(0, 600, size=(90, 2))
    rows = np.arange(150)
    found = solve_pose(pixels, points, Matches(rows, rows), (800, 600), [("given", 600.0)])
    assert found is not None and 50 <= found.keypoints <= 75
    assert np.abs(_error(found.posed)).max() < 0.02
