"""Ghost labels: names that appear along an edge and belong to neither side of it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import UNDETECTED
from fastsplat.service.evaluation.segmentation import check_maps

EDGE_PX = 2
NEAR_PX = 4


@dataclass(frozen=True)
class GhostCounts:
    """Pixels over any number of images; `+` merges two.

    Attributes:
        band: pixels near a label edge of the truth.
        ghosts: those of them whose answer is none of the truth's labels around them.
        named: those of the ghosts that carry a label, so are not merely undetected.
        pixels: all valid pixels.
    """

    band: int
    ghosts: int
    named: int
    pixels: int

    def __add__(self, other: GhostCounts) -> GhostCounts:
        return GhostCounts(
            self.band + other.band, self.ghosts + other.ghosts, self.named + other.named, self.pixels + other.pixels
        )

    def rate(self) -> float:
        """Ghosts as a share of the band; NaN without edges."""
        return self.ghosts / self.band if self.band else float("nan")

    def named_rate(self) -> float:
        """Ghosts that carry a label as a share of the band; NaN without edges."""
        return self.named / self.band if self.band else float("nan")

    def share_of_pixels(self) -> float:
        """Ghosts as a share of all valid pixels; NaN without any."""
        return self.ghosts / self.pixels if self.pixels else float("nan")


def ghost_counts(
    predicted: NDArray[np.integer],
    truth: NDArray[np.integer],
    labels: int,
    valid: NDArray[np.bool_] | None = None,
    *,
    edge_px: int = EDGE_PX,
    near_px: int = NEAR_PX,
) -> GhostCounts:
    """Counts of one image.

    The band is the pixels within `edge_px` of a label edge: the square of 2·edge_px + 1 pixels around them holds two or
    more of the truth's classes (undetected, where the truth has it, is one). A ghost is a pixel of the band whose
    answer does not occur in the truth within `near_px`. Pixels that are not valid lend no class and are not counted.

    Args:
        predicted, truth: [H, W] classes 0..labels.
        labels: N.
        valid: [H, W], or None when every pixel is.

    Raises:
        InvalidInputError: shapes that differ, or a class outside 0..N.
    """
    check_maps(predicted, truth, labels)
    chosen = np.ones(truth.shape, np.bool_) if valid is None else valid
    classes_at_edge = np.zeros(truth.shape, np.int32)
    near = np.zeros(truth.shape, np.bool_)
    for label in np.unique(truth[chosen]).tolist():
        here = ((truth == label) & chosen).astype(np.uint8)
        classes_at_edge += _grown(here, edge_px)
        near |= (_grown(here, near_px) > 0) & (predicted == label)
    band = chosen & (classes_at_edge > 1)
    ghosts = band & ~near
    named = ghosts & (predicted != UNDETECTED)
    return GhostCounts(int(band.sum()), int(ghosts.sum()), int(named.sum()), int(chosen.sum()))


def _grown(mask: NDArray[np.uint8], by: int) -> NDArray[np.uint8]:
    kernel = np.ones((2 * by + 1, 2 * by + 1), np.uint8)
    return np.asarray(cv2.dilate(mask, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0))
