"""Segmenters turn a box into the mask of the object inside it."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.segmenters.mask_postprocessing import select_mask
from fastsplat.service.perception.segmenters.open_segmenter import open_segmenter
from fastsplat_contract.errors import ModelUnavailableError
from tests.perception.conftest import read_rgb


def test_mobile_sam_cuts_out_true_boxes(test_data: Path, models_dir: Path) -> None:
    segmenter = open_segmenter(PerceptionSettings(threads=2), models_dir)
    folder = test_data / "tabletop"
    truth = cv2.imread(str(folder / "masks" / "018.png"), cv2.IMREAD_UNCHANGED)
    ids = json.loads((folder / "transforms.json").read_text())["labels"]
    wanted = [truth == ids[name] for name in ("banana", "orange", "ramekin", "table")]
    spans = [(np.flatnonzero(mask.any(0)), np.flatnonzero(mask.any(1))) for mask in wanted]
    boxes = np.array([[x[0], y[0], x[-1] + 1, y[-1] + 1] for x, y in spans], np.float32)
    masks = segmenter.masks(segmenter.embed(read_rgb(folder / "images" / "018.jpg")), boxes)
    assert masks.dtype == np.bool_
    for mask, true_mask in zip(masks, wanted, strict=True):
        assert (mask & true_mask).sum() / (mask | true_mask).sum() > 0.9


def test_sam2_masks_come_back_in_the_image(sam2_folder: Path) -> None:
    """300×100: the square network stretches, and the answer must not."""
    segmenter = open_segmenter(PerceptionSettings(segmenter="sam2:sam2"), sam2_folder.parent)
    embedding = segmenter.embed(np.full((100, 300, 3), 128, np.uint8))
    masks = segmenter.masks(embedding, np.array([[60, 25, 210, 75], [0, 0, 300, 100]], np.float32))
    expected = np.zeros((2, 100, 300), np.bool_)
    expected[0, 25:75, 60:210] = True
    expected[1] = True
    for mask, true_mask in zip(masks, expected, strict=True):
        assert (mask & true_mask).sum() / (mask | true_mask).sum() > 0.97


def test_no_boxes_no_masks(sam2_folder: Path) -> None:
    segmenter = open_segmenter(PerceptionSettings(segmenter="sam2:sam2"), sam2_folder.parent)
    masks = segmenter.masks(segmenter.embed(np.zeros((40, 50, 3), np.uint8)), np.zeros((0, 4), np.float32))
    assert masks.shape == (0, 40, 50)


def test_contract_of_the_other_generation_is_refused(sam2_folder: Path) -> None:
    with pytest.raises(ModelUnavailableError, match="contract"):
        open_segmenter(PerceptionSettings(segmenter="sam1:sam2"), sam2_folder.parent)


def test_two_encoders_are_one_too_many(sam2_folder: Path) -> None:
    (sam2_folder / "other.onnx").write_bytes((sam2_folder / "encoder.onnx").read_bytes())
    with pytest.raises(ModelUnavailableError, match="one encoder"):
        open_segmenter(PerceptionSettings(segmenter="sam2:sam2"), sam2_folder.parent)


def test_choice_prefers_the_object_then_the_sure_then_the_clean() -> None:
    def square(margin: int, height: float) -> np.ndarray:
        logits = np.full((40, 40), -height, np.float32)
        logits[margin : 40 - margin, margin : 40 - margin] = height
        return logits

    box = np.array([10, 10, 30, 30], np.float32)
    part, obj, spill = square(15, 5), square(10, 5), square(2, 5)
    equal = np.array([0.9, 0.9, 0.9], np.float32)
    assert select_mask(np.stack([part, obj, spill]), equal, box) == 1
    assert select_mask(np.stack([obj, obj]), np.array([0.5, 0.9], np.float32), box) == 1
    assert select_mask(np.stack([square(10, 0.5), obj]), equal[:2], box) == 1
    empty = np.full((40, 40), -1, np.float32)
    assert select_mask(np.stack([empty, part]), equal[:2], box) == 1
