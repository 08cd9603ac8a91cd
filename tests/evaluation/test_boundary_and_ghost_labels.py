"""Laws of the measures that look at edges, and the naive twins they must agree with."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fastsplat.service.evaluation.boundary_iou import boundary_counts, boundary_region, boundary_width
from fastsplat.service.evaluation.ghost_labels import GhostCounts, ghost_counts
from fastsplat.service.evaluation.segmentation import mask_counts
from fastsplat_contract.errors import InvalidInputError
from tests.evaluation import naive

LABELS = 4


def _blobs(seed: int, shape: tuple[int, int] = (23, 31)) -> np.ndarray:
    """A map of a few connected regions, as label maps are."""
    random = np.random.default_rng(seed)
    coarse = random.integers(0, LABELS + 1, (4, 5)).astype(np.uint8)
    return cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_NEAREST).astype(np.int64)


def _noisy(truth: np.ndarray, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed + 1000)
    wrong = random.random(truth.shape) < 0.1
    return np.where(wrong, random.integers(0, LABELS + 1, truth.shape), truth)


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000), share=st.sampled_from([0.02, 0.05, 0.1]))
def test_boundary_counts_agree_with_the_pixel_loop(seed: int, share: float) -> None:
    truth = _blobs(seed)
    predicted = _noisy(truth, seed)
    width = boundary_width(*truth.shape, share)
    scores = boundary_counts(predicted, truth, LABELS, diagonal_share=share).iou()
    for label in range(LABELS + 1):
        expected = naive.iou(naive.region(predicted == label, width), naive.region(truth == label, width))
        assert scores[label] == pytest.approx(expected, nan_ok=True)


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000), masked=st.booleans())
def test_ghosts_agree_with_the_pixel_loop(seed: int, masked: bool) -> None:
    truth = _blobs(seed)
    predicted = _noisy(truth, seed)
    valid = np.random.default_rng(seed).random(truth.shape) < (0.8 if masked else 2)
    counts = ghost_counts(predicted, truth, LABELS, valid)
    assert (counts.ghosts, counts.band) == naive.ghosts(predicted, truth, valid)
    assert counts.pixels == valid.sum()


@pytest.mark.parametrize("seed", range(5))
def test_the_truth_has_perfect_boundaries_and_no_ghosts(seed: int) -> None:
    truth = _blobs(seed)
    counts = boundary_counts(truth, truth, LABELS)
    assert counts.macro_iou() == 1 == counts.micro_iou()
    assert ghost_counts(truth, truth, LABELS).rate() == 0


@pytest.mark.parametrize("seed", range(5))
def test_the_neighbour_across_an_edge_is_wrong_but_no_ghost(seed: int) -> None:
    truth = _blobs(seed)
    shifted = np.roll(truth, 2, axis=1)
    shifted[:, :2] = truth[:, :2]
    counts = ghost_counts(shifted, truth, LABELS)
    assert counts.rate() == 0 and (shifted != truth).any()


def test_a_third_label_along_an_edge_is_a_ghost_and_far_from_it_is_not() -> None:
    truth = np.ones((20, 20), int)
    truth[:, 10:] = 2
    predicted = truth.copy()
    predicted[:, 10] = 3
    predicted[:, 0] = 3
    assert ghost_counts(predicted, truth, 3) == GhostCounts(band=80, ghosts=20, named=20, pixels=400)


def test_nothing_said_at_an_edge_is_a_ghost_without_a_name() -> None:
    truth = np.ones((20, 20), int)
    truth[:, 10:] = 2
    counts = ghost_counts(np.zeros_like(truth), truth, 2)
    assert counts.rate() == 1 and counts.named_rate() == 0
    background = np.where(truth == 2, 0, truth)
    assert ghost_counts(np.zeros_like(truth), background, 2).rate() == 0


def test_a_map_without_edges_has_no_ghost_rate() -> None:
    assert np.isnan(ghost_counts(np.full((5, 5), 2), np.ones((5, 5), int), 2).rate())


def test_one_pixel_of_shift_costs_the_boundary_more_than_the_area() -> None:
    truth = np.zeros((120, 160), int)
    truth[30:90, 40:120] = 1
    shifted = np.roll(truth, 1, axis=1)
    plain = mask_counts(shifted, truth, 1).iou()[1]
    bounded = boundary_counts(shifted, truth, 1).iou()[1]
    assert bounded < plain < 1


def test_a_wider_region_than_the_thing_is_the_plain_iou() -> None:
    truth, predicted = _blobs(3), _noisy(_blobs(3), 3)
    wide = boundary_counts(predicted, truth, LABELS, diagonal_share=2.0)
    assert wide.iou() == pytest.approx(mask_counts(predicted, truth, LABELS).iou(), nan_ok=True)


def test_the_region_lies_in_the_mask_and_grows_with_its_width() -> None:
    mask = _blobs(1) == 2
    previous = np.zeros_like(mask)
    for width in range(1, 8):
        found = boundary_region(mask, width)
        assert not (found & ~mask).any() and not (previous & ~found).any()
        previous = found


def test_width_follows_the_diagonal_and_never_vanishes() -> None:
    assert boundary_width(360, 480, 0.02) == 12
    assert boundary_width(4, 4, 0.02) == 1


@pytest.mark.parametrize("measure", [boundary_counts, ghost_counts])
def test_a_missing_prediction_lowers_and_the_order_of_images_does_not_matter(measure) -> None:
    truths = [_blobs(seed) for seed in range(4)]
    found = [_noisy(truth, seed) for seed, truth in enumerate(truths)]
    missing = [*found[:3], np.zeros_like(found[3])]

    def total(maps, order):
        parts = [measure(maps[index], truths[index], LABELS) for index in order]
        result = parts[0]
        for part in parts[1:]:
            result = result + part
        return result

    if measure is boundary_counts:
        assert total(missing, range(4)).macro_iou() < total(found, range(4)).macro_iou()
        assert (total(found, range(4)).counts == total(found, [2, 0, 3, 1]).counts).all()
    else:
        assert total(missing, range(4)).rate() > total(found, range(4)).rate()
        assert total(found, range(4)) == total(found, [2, 0, 3, 1])


@pytest.mark.parametrize("measure", [boundary_counts, ghost_counts])
def test_maps_that_do_not_fit_are_refused(measure) -> None:
    with pytest.raises(InvalidInputError, match="shape"):
        measure(np.zeros((2, 3), int), np.zeros((3, 2), int), 1)
    with pytest.raises(InvalidInputError, match=r"0\.\.1"):
        measure(np.full((2, 2), 2), np.zeros((2, 2), int), 1)
