"""Ghost labels: labels that appear along an edge and belong to neither side of it.

Blended semantic codes of two labels may lie in a third label's cell. (Not "floaters", which are stray Gaussians in
front of a surface; a ghost label may be one that no Gaussian there has.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import UNDETECTED
from fastsplat.service.evaluation.segmentation import check_maps
from fastsplat.service.evaluation.types import Skipped, ViewMetric, ViewPrediction

EDGE_PX = 2
NEAR_PX = 4


@dataclass(frozen=True)
class GhostCounts:
    """Pixels over any number of images; `+` merges two.

    Attributes:
        band: pixels near a label edge of the truth.
        ghosts: those of them whose predicted label is none of the truth's labels around them.
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
    predicted class does not occur in the truth within `near_px`. Pixels that are not valid lend no class and are not
    counted.

    Args:
        predicted, truth: [H, W] classes 0..labels.
        labels: N.
        valid: [H, W], or None when every pixel is.

    Raises:
        InvalidInputError: shapes that differ, or a class outside 0..N.
    """
    check_maps(predicted, truth, labels)
    counted = np.ones(truth.shape, np.bool_) if valid is None else valid
    classes_at_edge = np.zeros(truth.shape, np.int32)
    near = np.zeros(truth.shape, np.bool_)
    for label in np.unique(truth[counted]).tolist():
        here = ((truth == label) & counted).astype(np.uint8)
        classes_at_edge += _dilated(here, edge_px)
        near |= (_dilated(here, near_px) > 0) & (predicted == label)
    band = counted & (classes_at_edge > 1)
    ghosts = band & ~near
    named = ghosts & (predicted != UNDETECTED)
    return GhostCounts(int(band.sum()), int(ghosts.sum()), int(named.sum()), int(counted.sum()))


def _dilated(mask: NDArray[np.uint8], by: int) -> NDArray[np.uint8]:
    kernel = np.ones((2 * by + 1, 2 * by + 1), np.uint8)
    return np.asarray(cv2.dilate(mask, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0))


def view_ghost_counts(view: ViewPrediction) -> GhostCounts | Skipped:
    """Counts of the view's label map."""
    if view.truth.labels is None:
        return Skipped("the view has no label map")
    return ghost_counts(view.label_map, view.truth.labels, len(view.dictionary), view.truth.valid)


def _total(counts: Sequence[GhostCounts]) -> GhostCounts:
    return sum(counts[1:], counts[0])


_NO_EDGE = "no test view shows an edge between labels"
_PARAMETERS = {"edge_px": EDGE_PX, "near_px": NEAR_PX}

GHOST_RATE = ViewMetric(
    name="ghost_rate",
    unit="",
    higher_is_better=False,
    description="share of the pixels within edge_px of a label edge whose predicted label does not occur within "
    "near_px",
    measure=view_ghost_counts,
    combine=lambda counts: _total(counts).rate(),
    undefined=_NO_EDGE,
    parameters=_PARAMETERS,
    headline=True,
)
GHOST_RATE_NAMED = ViewMetric(
    name="ghost_rate_named",
    unit="",
    higher_is_better=False,
    description="as ghost_rate, of pixels that carry a label and are not merely undetected",
    measure=view_ghost_counts,
    combine=lambda counts: _total(counts).named_rate(),
    undefined=_NO_EDGE,
    parameters=_PARAMETERS,
)
GHOST_SHARE_OF_PIXELS = ViewMetric(
    name="ghost_share_of_pixels",
    unit="",
    higher_is_better=False,
    description="the pixels that ghost_rate counts, as a share of all pixels that count",
    measure=view_ghost_counts,
    combine=lambda counts: _total(counts).share_of_pixels(),
    undefined="no pixel of a test view counts",
    parameters=_PARAMETERS,
)
