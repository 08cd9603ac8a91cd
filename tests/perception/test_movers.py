"""Who is asked for what is to be withheld, and how boxes become what is withheld."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fastsplat.service.perception.label_maps.movers import MoverDetectors, MoverMasks, mover_detectors, open_withholding
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Detections, MaskLogits, Prompts, ViewMasks
from fastsplat_contract.errors import ModelUnavailableError

_SETTINGS = PerceptionSettings(closer_look=False)
_BOX = (20.0, 10.0, 60.0, 90.0)


class _Detector:
    """Sees a person in `_BOX`, and a chair elsewhere."""

    labels = ("person", "chair")

    def detect(self, image: NDArray[np.uint8], min_score: float) -> Detections:
        boxes = np.array([_BOX, (70, 10, 95, 40)], np.float32)
        return Detections(boxes, np.array([0.9, 0.9], np.float32), self.labels)


class _Segmenter:
    """Answers every prompt with the same mask, bool [H, W]."""

    def __init__(self, mask: NDArray[np.bool_]) -> None:
        self._mask = mask

    def embed(self, image: NDArray[np.uint8]) -> Any:
        return None

    def masks(self, embedding: Any, boxes: NDArray[np.float32]) -> NDArray[np.bool_]:
        raise AssertionError("the logits are enough")

    def mask_logits(self, embedding: Any, prompts: Prompts) -> MaskLogits:
        logits = np.where(self._mask, 4.0, -4.0).astype(np.float32)[None, None].repeat(len(prompts), axis=0)
        return MaskLogits(logits, np.full((len(prompts), 1), 0.9, np.float32), (1.0, 1.0))


def _withheld(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    masks = MoverMasks(MoverDetectors(("person",), ()), _Detector(), None, _Segmenter(mask), _SETTINGS)
    return masks(np.zeros((100, 100, 3), np.uint8))


def test_a_mask_is_widened_and_other_classes_stay() -> None:
    mask = np.zeros((100, 100), np.bool_)
    mask[12:88, 25:55] = True
    withheld = _withheld(mask)
    assert withheld[mask].all() and withheld.sum() > mask.sum()
    assert not withheld[10:40, 70:95].any()
    assert withheld.sum() < 1.5 * mask.sum()


def test_where_the_mask_is_hardly_the_whole_of_it_the_box_is_withheld() -> None:
    shirt = np.zeros((100, 100), np.bool_)
    shirt[30:50, 25:55] = True  # neither head nor legs
    assert _withheld(shirt)[10:90, 20:60].all()
    assert _withheld(np.zeros((100, 100), np.bool_))[10:90, 20:60].all()


def test_every_word_must_be_known_to_a_detector(tmp_path: Path) -> None:
    assert mover_detectors(None, "people", _SETTINGS, tmp_path) == MoverDetectors(("person",), ())
    assert mover_detectors("ignore", None, _SETTINGS, tmp_path).closed_set == _SETTINGS.mover_words
    both = mover_detectors("ignore", "people", _SETTINGS, tmp_path).closed_set
    assert len(both) == len(set(both)) and {"person", *_SETTINGS.mover_words} == set(both)
    unknown = _SETTINGS.model_copy(update={"mover_words": ("person", "robot vacuum")})
    with pytest.raises(ModelUnavailableError) as caught:
        mover_detectors("ignore", None, unknown, tmp_path)
    assert "robot vacuum" in caught.value.message and "person" not in caught.value.message
    assert caught.value.field == "movers" and caught.value.hint


def test_nothing_is_opened_where_nothing_is_withheld_and_a_missing_model_is_said(tmp_path: Path) -> None:
    assert open_withholding(None, None, _SETTINGS, tmp_path) is None
    assert open_withholding("keep", None, _SETTINGS, tmp_path) is None
    with pytest.raises(ModelUnavailableError):
        open_withholding(None, "people", _SETTINGS, tmp_path)


def test_masks_of_what_is_withheld_are_dropped_and_others_cut() -> None:
    masks = np.zeros((2, 20, 30), np.bool_)
    masks[0, :, :12], masks[1, :, 18:] = True, True
    content = np.ones((40, 60), np.bool_)
    content[:, :30] = False
    content[:, 40:44] = False
    views = ViewMasks(np.packbits(masks.reshape(2, -1), axis=1), np.array([0.8, 0.9], np.float32), 30, 20, 7)
    cut = views.within(content)
    assert len(cut) == 1 and cut.quality[0] == np.float32(0.9) and cut.prompts == 7
    expected = masks[1].copy()
    expected[:, 20:22] = False
    assert np.array_equal(cut.resized(30, 20)[0], expected)
