"""Pairs that agree on the wrong copy of a repeating pattern are told by loops of matches."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fastsplat.service.capture.sfm.match_cycles import contradicting_pairs

_TILE = 10
_SEEN = 40


def _walk(
    wrong: set[tuple[int, int]],
) -> tuple[dict[tuple[int, int], NDArray[np.uint32]], dict[int, NDArray[np.float32]]]:
    """Six images of a long wall, each four features further on; the wrong pairs match one tile further on."""
    pixels = {i: np.stack([20.0 * np.arange(_SEEN), np.zeros(_SEEN)], axis=1).astype(np.float32) for i in range(6)}
    matches = {}
    for i in range(6):
        for j in range(i + 1, 6):
            rows = np.arange(_SEEN)
            there = rows - 4 * (j - i) + (_TILE if (i, j) in wrong else 0)
            visible = (there >= 0) & (there < _SEEN)
            matches[i, j] = np.stack([rows[visible], there[visible]], axis=1).astype(np.uint32)
    return matches, pixels


@pytest.mark.parametrize("wrong", [set(), {(0, 3)}, {(0, 4), (1, 5)}, {(0, 5), (2, 4)}])
def test_exactly_the_pairs_that_are_off_by_a_tile_are_told(wrong: set[tuple[int, int]]) -> None:
    matches, pixels = _walk(wrong)
    assert set(contradicting_pairs(matches, pixels)) == wrong


def test_a_feature_with_two_orientations_is_no_contradiction() -> None:
    matches, pixels = _walk(set())
    pixels = {image: np.repeat(places[::2], 2, axis=0) for image, places in pixels.items()}
    matches[0, 3] = matches[0, 3] ^ np.array([0, 1], np.uint32)  # the twin of each feature of the second image
    assert contradicting_pairs(matches, pixels) == []
