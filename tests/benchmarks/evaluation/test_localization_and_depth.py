"""Laws of localization, depth errors and 3D masks."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.evaluation.depth_error import depth_error
from benchmarks.evaluation.localization import box_of, peak, peak_in_box
from benchmarks.evaluation.mask3d_iou import NO_TRUTH, TrueSurface, gaussian_truth, mask3d_counts
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera, PosedCamera


def test_a_ring_has_its_peak_in_the_box() -> None:
    ring = np.zeros((21, 21), bool)
    ring[3:18, 3:18] = True
    ring[6:15, 6:15] = False
    relevancy = np.zeros((21, 21), np.float32)
    relevancy[10, 10] = 1
    assert box_of(ring) == (3, 3, 18, 18)
    assert peak_in_box(relevancy, [box_of(ring)])


def test_nothing_found_points_nowhere() -> None:
    nothing = np.zeros((4, 4), np.float32)
    assert peak(nothing) is None and peak(np.full((2, 2), np.nan)) is None
    assert not peak_in_box(nothing, [(0, 0, 4, 4)])
    assert box_of(np.zeros((3, 3), bool)) is None


def test_a_plateau_peaks_at_its_depth_not_at_its_first_pixel() -> None:
    flat = np.zeros((30, 30), np.float32)
    flat[5:25, 5:25] = 1
    row, column = peak(flat)
    assert 13 <= row <= 16 and 13 <= column <= 16
    flat[1, 1] = 1
    assert peak(flat) == (row, column)


def test_one_of_several_boxes_is_enough() -> None:
    relevancy = np.zeros((10, 10))
    relevancy[8, 8] = 1
    assert peak_in_box(relevancy, [(0, 0, 2, 2), (8, 8, 9, 9)])
    assert not peak_in_box(relevancy, [(0, 0, 2, 2), (8.6, 8, 9, 9)])
    assert not peak_in_box(relevancy, [])


def test_missing_depth_counts_as_all_wrong_and_unknown_truth_not_at_all() -> None:
    truth = np.full((2, 2), 2.0)
    half = truth.copy()
    half[0] = 0
    assert depth_error(half, truth) == 0.5
    assert depth_error(truth, half) == 0
    assert depth_error(half, truth, np.array([[False, False], [True, True]])) == 0
    assert depth_error(truth, np.zeros((2, 2))) is None
    with pytest.raises(InvalidInputError, match="shape"):
        depth_error(truth, np.ones((3, 2)))


def test_centres_on_the_true_surface_get_its_label_and_others_none() -> None:
    camera = Camera(40, 20, 30, 30, 20, 10)
    pose = np.eye(4)
    pose[0, 3] = 1.5
    labels = np.ones((20, 40), int)
    labels[:, 20:] = 2
    surfaces = [TrueSurface(PosedCamera(camera, at), np.full((20, 40), 2.0), labels) for at in (np.eye(4),)]
    means = np.array([[-0.5, 0, 2], [0.5, 0, 2.03], [0.5, 0, 2.5], [0, 0, -2], [9, 0, 2]])
    truth = gaussian_truth(means, surfaces, 2)
    assert truth.tolist() == [1, 2, NO_TRUTH, NO_TRUTH, NO_TRUTH]
    moved = [TrueSurface(PosedCamera(camera, pose), np.full((20, 40), 2.0), labels)]
    assert gaussian_truth(means + np.array([1.5, 0, 0]), moved, 2).tolist() == truth.tolist()
    result = mask3d_counts(np.array([1, 1, 2, 2, 2]), truth, 2)
    assert result.iou()[1:] == pytest.approx([0.5, 0])
    assert mask3d_counts(np.array([1, 2, 0, 0, 0]), truth, 2).macro_iou() == 1


def test_views_vote_about_a_gaussian() -> None:
    posed = PosedCamera(Camera(4, 4, 4, 4, 2, 2), np.eye(4))
    views = [TrueSurface(posed, np.ones((4, 4)), np.full((4, 4), label)) for label in (2, 1, 2)]
    assert gaussian_truth(np.array([[0, 0, 1.0]]), views, 2).tolist() == [2]
    assert gaussian_truth(np.array([[0, 0, 1.0]]), views[:2], 2).tolist() == [1]  # a tie
    assert gaussian_truth(np.zeros((0, 3)), views, 2).tolist() == []
