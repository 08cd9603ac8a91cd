"""Masks without names: what a segmenter is sure of, each once, where it belongs in the image."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.perception.models.model_files import batch_decoder, encoder_and_decoder
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Detections, MaskLogits, ViewMasks, box_prompts, point_prompts
from fastsplat.service.perception.segmenters.mask_proposals import (
    MaskProposals,
    boxes_to_prompt,
    distinct_proposals,
    sure_proposals,
)
from fastsplat.service.perception.segmenters.open_segmenter import open_segmenter
from tests.perception.conftest import read_rgb

SETTINGS = PerceptionSettings(min_pixels=4)


def _square(top: int, left: int, side: int, size: int = 32, height: float = 5.0) -> np.ndarray:
    logits = np.full((size, size), -height, np.float32)
    logits[top : top + side, left : left + side] = height
    return logits


def _proposals(layers: list[np.ndarray], quality: list[float]) -> MaskProposals:
    return MaskProposals(
        np.stack(layers).astype(np.float16), np.array(quality, np.float32), (1.0, 1.0), layers[0].shape
    )


def test_boxes_of_objects_come_first_and_rivals_are_left_out() -> None:
    objects = Detections(np.array([[0, 0, 10, 10], [0, 0, 10, 9]], np.float32), np.full(2, 0.4, np.float32), ("a", "b"))
    rivals = Detections(
        np.array([[0, 0, 10, 10], [50, 50, 60, 60], [50, 50, 60, 61]], np.float32),
        np.array([0.9, 0.5, 0.6], np.float32),
        ("c", "d", "e"),
    )
    boxes = boxes_to_prompt(objects, rivals, SETTINGS)
    assert boxes.tolist() == [[0, 0, 10, 10], [0, 0, 10, 9], [50, 50, 60, 61]]
    assert boxes_to_prompt(objects.take([]), rivals.take([]), SETTINGS).shape == (0, 4)


def test_of_two_answers_the_one_to_a_box_stays() -> None:
    both = _proposals([_square(4, 4, 20), _square(4, 4, 21)], [0.8, 0.99])
    assert distinct_proposals(both, 0.75).quality.tolist() == pytest.approx([0.99])
    assert distinct_proposals(both, 0.75, first=1).quality.tolist() == pytest.approx([0.8])


@given(st.integers(1, 40), st.integers(1, 30), st.integers(0, 5))
def test_stored_masks_come_back(width: int, height: int, count: int) -> None:
    masks = np.random.default_rng(count).random((count, height, width)) < 0.5
    bits = np.packbits(masks.reshape(count, width * height), axis=1)
    stored = ViewMasks(bits, np.ones(count, np.float32), width, height, count)
    assert (stored.resized(width, height) == masks).all()
    assert (stored.resized(2 * width, 3 * height) == masks.repeat(3, axis=1).repeat(2, axis=2)).all()


def test_only_sure_stable_and_large_answers_count() -> None:
    ragged = _square(4, 4, 20, height=5.0)
    ragged[2:4] = 0.5  # inside at 0 and not at +1
    ragged[24:30] = -0.5  # inside at -1 and not at 0
    layers = np.stack([_square(4, 4, 20), _square(4, 4, 20), ragged, _square(4, 4, 1)])
    answer = MaskLogits(layers[None], np.array([[0.9, 0.5, 0.9, 0.9]], np.float32), (1.0, 1.0))
    proposals = sure_proposals(answer, (32, 32), SETTINGS)
    assert len(proposals) == 1
    assert proposals.quality[0] == pytest.approx(0.9)
    assert (proposals.masks(32, 32)[0] == (layers[0] > 0)).all()


@given(st.lists(st.tuples(st.integers(0, 20), st.integers(0, 20), st.integers(2, 12)), min_size=1, max_size=12))
def test_distinct_proposals_are_no_doubles_and_lose_nothing(squares: list[tuple[int, int, int]]) -> None:
    proposals = _proposals([_square(*square) for square in squares], [0.5 + 0.01 * i for i in range(len(squares))])
    distinct = distinct_proposals(proposals, 0.7)

    def overlap(a: np.ndarray, b: np.ndarray) -> float:
        return float((a & b).sum() / (a | b).sum())

    before, after = proposals.masks(32, 32), distinct.masks(32, 32)
    for i, mask in enumerate(after):
        assert all(overlap(mask, other_mask) <= 0.7 for other_mask in after[:i])
    for mask, quality in zip(before, proposals.quality, strict=True):
        better = after[distinct.quality >= quality]
        assert any((mask == other_mask).all() or overlap(mask, other_mask) > 0.7 for other_mask in better)


def test_masks_come_back_at_any_size_of_the_image() -> None:
    """A grid of a quarter of the image's steps: the square covers the same part of the image at every size."""
    proposals = MaskProposals(
        _square(8, 4, 8)[None].astype(np.float16), np.ones(1, np.float32), (0.25, 0.25), (128, 128)
    )
    for size in (128, 64, 200):
        mask = proposals.masks(size, size)[0]
        rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
        box = np.array([rows[0], rows[-1] + 1, columns[0], columns[-1] + 1]) / size
        assert np.abs(box - [0.25, 0.5, 0.125, 0.375]).max() <= 1.01 / size


def test_a_real_segmenter_answers_points_and_boxes_alike(test_data: Path, models_dir: Path) -> None:
    """The logits of a box prompt are where `masks` puts the mask of the same box."""
    segmenter = open_segmenter(PerceptionSettings(threads=1), models_dir)
    image = read_rgb(test_data / "tabletop" / "images" / "018.jpg")
    embedding, boxes = segmenter.embed(image), np.array([[100, 100, 260, 220]], np.float32)
    answer = segmenter.mask_logits(embedding, box_prompts(boxes))
    layers = answer.logits[0].astype(np.float16)
    ours = MaskProposals(layers, answer.quality[0], answer.scale, image.shape[:2]).masks(image.shape[1], image.shape[0])
    selected = segmenter.masks(embedding, boxes)[0]
    assert max((selected & mask).sum() / (selected | mask).sum() for mask in ours) > 0.98
    points = segmenter.mask_logits(embedding, point_prompts(np.array([[180.0, 160.0], [20.0, 20.0]])))
    assert points.logits.shape[0] == 2 and points.quality.shape == points.logits.shape[:2]


def test_one_by_one_and_in_batches_are_the_same(
    test_data: Path, models_dir: Path, pulled: Callable[[str], Path], tmp_path: Path
) -> None:
    models = models_dir
    if batch_decoder(models / "mobile_sam", name="mobile_sam") is None:  # pulled by an earlier release
        models = pulled("mobile_sam")
    folder = models / "mobile_sam"
    for path in encoder_and_decoder(folder, name="mobile_sam"):
        (tmp_path / "alone" / path.name).parent.mkdir(exist_ok=True)
        (tmp_path / "alone" / path.name).symlink_to(path)
    image = read_rgb(test_data / "tabletop" / "images" / "018.jpg")
    answers = []
    for settings, model_folder in (
        (PerceptionSettings(threads=1), models),
        (PerceptionSettings(threads=1, segmenter="sam1:alone"), tmp_path),
    ):
        segmenter = open_segmenter(settings, model_folder)
        points = np.stack(np.meshgrid([40.0, 160.0, 280.0], [30.0, 110.0, 200.0]), axis=-1).reshape(-1, 2)
        answers.append(segmenter.mask_logits(segmenter.embed(image), point_prompts(points)))
    assert np.abs(answers[0].quality - answers[1].quality).max() < 0.01
    assert ((answers[0].logits > 0) == (answers[1].logits > 0)).mean() > 0.999
