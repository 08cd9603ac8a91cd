"""Protocols of other papers agree with cases computed by hand, and with their formulas by another library."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, correlate, uniform_filter

from benchmarks.evaluation.datasets.dataset import Dataset, QueryTruth, TrueView
from benchmarks.evaluation.published.mask_pairs import (
    PairScore,
    lerf_mask,
    pair_score,
    share_above,
    silhouette_mask,
)
from benchmarks.evaluation.published.relevancy_maps import localized, mean_filtered, thresholded_mask
from benchmarks.evaluation.scene_evaluation import evaluate_scene
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera
from tests.benchmarks.evaluation import made_data
from tests.scenes import labelled_scene

RNG = np.random.default_rng(7)


def _square(rows: slice, columns: slice, shape: tuple[int, int] = (40, 50)) -> NDArray[np.bool_]:
    mask = np.zeros(shape, np.bool_)
    mask[rows, columns] = True
    return mask


def test_the_mean_filter_moves_localization_from_a_lone_pixel_to_the_object() -> None:
    relevancy = np.where(_square(slice(5, 25), slice(5, 25), (60, 80)), 0.8, 0.0)
    relevancy[50, 70] = 1.0
    obj, speck = (5.0, 5.0, 25.0, 25.0), (69.0, 49.0, 72.0, 52.0)
    assert localized(relevancy, [obj]) and not localized(relevancy, [speck])
    assert localized(relevancy, [speck], mean_filter_px=1) and not localized(relevancy, [obj], mean_filter_px=1)
    assert localized(relevancy, [speck, obj]), "any box is enough"
    assert localized(relevancy, [(25.0, 25.0, 5.0, 5.0)]), "corners in any order"
    assert not localized(relevancy, []) and not localized(np.zeros((4, 4)), [(0.0, 0.0, 4.0, 4.0)])


def test_a_mask_is_what_the_formula_says() -> None:
    relevancy = RNG.random((24, 31))
    relevancy[12:, 12:] += 1.5
    blended = (uniform_filter(relevancy, 8, mode="mirror") + relevancy) / 2
    stretched = (blended - blended.min()) / (blended.max() - blended.min() + 1e-9)
    votes = np.where(2 * stretched - 1 > 0.4, 1, -1)
    votes[-1], votes[:, -1] = 0, 0  # as in the published code, whose windows end before
    expected = correlate(votes, np.ones((7, 7), int), mode="constant") > 0
    mask = thresholded_mask(relevancy, 0.4, mean_filter_px=8)
    assert (mask == expected).all() and 0.1 < mask.mean() < 0.5


@pytest.mark.parametrize("broken", [np.zeros((2, 3, 4)), np.zeros((0, 3)), np.zeros(5)])
def test_what_is_no_map_is_refused(broken: NDArray[np.float64]) -> None:
    for call in (mean_filtered, thresholded_mask, lambda values: localized(values, [])):
        with pytest.raises(InvalidInputError, match="relevancy map"):
            call(broken)
    with pytest.raises(InvalidInputError, match="threshold"):
        thresholded_mask(np.ones((3, 3)), 1.0)
    with pytest.raises(InvalidInputError, match="filter"):
        mean_filtered(np.ones((3, 3)), 0)


def test_nan_is_no_relevancy() -> None:
    values = RNG.random((12, 12))
    holes = np.where(values < 0.1, np.nan, values)
    assert (thresholded_mask(holes) == thresholded_mask(np.where(values < 0.1, 0, values))).all()


def test_a_pair_has_the_ious_of_its_masks_and_of_their_boundaries() -> None:
    truth = _square(slice(4, 24), slice(4, 24))
    predicted = _square(slice(4, 24), slice(14, 34))
    score = pair_score("mug", truth, predicted)
    assert score.iou == pytest.approx(200 / 600) and score.predicted
    square = np.ones((3, 3))  # 2 % of 64 pixels to each side
    edge, predicted_edge = (mask & ~binary_erosion(mask, square) for mask in (truth, predicted))
    boundary_iou = (edge & predicted_edge).sum() / (edge | predicted_edge).sum()
    assert score.boundary_iou == pytest.approx(boundary_iou) and boundary_iou < score.iou
    assert pair_score("mug", truth, truth) == PairScore("mug", True, 1, 1)
    missing = pair_score("mug", truth, None)
    assert (missing.predicted, missing.iou, missing.boundary_iou) == (False, 0, 0)
    with pytest.raises(InvalidInputError, match="nowhere"):
        pair_score("mug", np.zeros((3, 3), np.bool_), None)


def test_a_prediction_of_another_size_is_brought_to_the_truths() -> None:
    coarse = RNG.random((10, 12)) < 0.4
    truth = np.kron(coarse, np.ones((3, 3), np.bool_)).astype(np.bool_)
    assert pair_score("mug", truth, coarse).iou == 1


def _score(text: str, iou: float, *, predicted: bool = True) -> PairScore:
    return PairScore(text, predicted, iou, iou / 2)


def test_each_paper_weights_its_pairs_in_its_own_way() -> None:
    """Two views, of which the second shows one text; "bed" was not answered once."""
    scores = [
        _score("mug", 0.9),
        _score("bed", 0.0, predicted=False),
        _score("cup", 0.3),
        _score("mug", 0.5),
        _score("bed", 0.6),
    ]
    for strict, expected in ((True, (0.7 + 0.3 + 0.3) / 3), (False, (0.7 + 0.6 + 0.3) / 3)):
        assert lerf_mask(scores, lambda score: score.iou, strict=strict) == pytest.approx(expected)
    shares = [share_above([score.iou for score in scores], bound) for bound in (0.25, 0.5)]
    assert shares == [4 / 5, 2 / 5], "0.5 is not above 0.5"


def test_nothing_asked_is_nothing_measured() -> None:
    assert math.isnan(lerf_mask([], lambda score: score.iou, strict=True)) and math.isnan(share_above([], 0.25))
    silent = [_score("mug", 0.0, predicted=False)]
    strict, lenient = (lerf_mask(silent, lambda score: score.iou, strict=strict) for strict in (True, False))
    assert strict == 0 and math.isnan(lenient)


def test_selected_gaussians_are_drawn_whole_though_others_hide_them() -> None:
    """A wide ball hides a small one: no rendered label is the small one's, and its silhouette has all of it."""
    labels = ("front ball", "hidden ball")
    scene = labelled_scene(
        [[0, 0, 1.5], [0, 0, 3]], [1, 2], labels, undetected_bias=4.0, encoder=made_data.WordEncoder()
    )
    index = made_data.index(scene)
    posed = PosedCamera(made_data.CAMERA, np.eye(4), "a")
    alone = made_data.index(
        labelled_scene([[0, 0, 3]], [1], (labels[1],), undetected_bias=4.0, encoder=made_data.WordEncoder())
    )
    whole = alone.label_map(posed) > 0
    assert whole.any() and not (index.label_map(posed) == 2).any()
    queries = (QueryTruth(labels[1], whole, ((0.0, 0.0, 64.0, 48.0),)),)
    views = (TrueView("a", posed, index.render(posed), queries=queries),)
    report = evaluate_scene(index, Dataset(Path("made"), "lerf_ovs", dictionary_of(labels), (), views))
    assert report.figures["miou_opengaussian"] > 0.6 and report.figures["acc50_opengaussian"] == 1
    assert report.figures["miou_views"] == 0 == report.figures["miou_lerf_mask"]
    assert not silhouette_mask(np.array([0.7, 0.2])).any() and silhouette_mask(np.array([0.71])).all()
