"""What a photo and the scene's picture from the same place do not have in common."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.localization.photometric_refinement import Comparison
from fastsplat_contract.localize_messages import DifferenceKind

_SLACK_PX = 5
"""Width of the window in which either picture may have the color of the other one: poses are a pixel or two off."""
_LEAST = 0.12
"""Of a color channel, 0..1, beyond what both pictures have around there."""
_TIMES_USUAL = 4.0
"""As many times the usual difference, where the scene is reproduced badly everywhere."""
_LEAST_SHARE = 0.004
_MOST = 16
_EDGE_RATIO = 1.5


@dataclass(frozen=True)
class Difference:
    """A region in which photo and scene disagree.

    Attributes:
        kind: "new": only the photo has an outline there; "missing": only the scene has; "changed": both have, or
            neither.
        box: left, top, right, bottom, pixels of the photo.
        strength: mean difference of the color there beyond exposure, 0..1.
    """

    kind: DifferenceKind
    box: tuple[float, float, float, float]
    strength: float


def find_differences(comparison: Comparison, size: tuple[int, int]) -> tuple[Difference, ...]:
    """The regions in which a photo differs from what the scene shows, the strongest and largest first; at most 16.

    A pixel differs where its color is outside of all that the other picture has within two pixels, in both directions,
    and where the scene has a sure surface. Regions of less than 0.4 % of the picture are left out.

    Args:
        comparison: from the photo's pose, with its exposure.
        size: width and height of the photo, for the boxes.
    """
    excess = np.minimum(_outside(comparison.photo, comparison.shown), _outside(comparison.shown, comparison.photo))
    covered = cv2.erode(comparison.sure.astype(np.uint8), np.ones((_SLACK_PX, _SLACK_PX), np.uint8)) > 0
    if not covered.any():
        return ()
    excess = np.asarray(cv2.GaussianBlur(np.where(covered, excess, 0.0).astype(np.float32), (0, 0), 2.0))
    least = max(_LEAST, _TIMES_USUAL * float(excess[covered].mean()))
    beyond = ((excess > least) & covered).astype(np.uint8)
    differs = cv2.morphologyEx(beyond, cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    count, areas, boxes, _ = cv2.connectedComponentsWithStats(differs, connectivity=8)
    found: list[tuple[float, Difference]] = []
    height, width = excess.shape
    for number in range(1, count):
        left, top, across, down, pixels = boxes[number].tolist()
        if pixels < _LEAST_SHARE * excess.size:
            continue
        region = areas == number
        strength = float(excess[region].mean())
        x, y = size[0] / width, size[1] / height
        box = (left * x, top * y, (left + across) * x, (top + down) * y)
        found.append((strength * pixels, Difference(_kind(comparison, region), box, min(1.0, strength))))
    found.sort(key=lambda item: -item[0])
    return tuple(difference for _, difference in found[:_MOST])


def _outside(one: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.float32]:
    """[H, W]: how far a picture's colors are outside of all that the other one has around there."""
    around = np.ones((_SLACK_PX, _SLACK_PX), np.uint8)
    soft_one, soft_other = (cv2.GaussianBlur(picture, (0, 0), 1.5) for picture in (one, other))
    above = soft_one - cv2.dilate(soft_other, around)
    below = cv2.erode(soft_other, around) - soft_one
    return np.asarray(np.maximum(np.maximum(above, below), 0.0).max(axis=2), np.float32)


def _kind(comparison: Comparison, region: NDArray[np.bool_]) -> DifferenceKind:
    """By which picture has the outline: what is only in the photo ends there in the photo alone."""
    wide = np.ones((7, 7), np.uint8)
    mask = region.astype(np.uint8)
    rim = (cv2.dilate(mask, wide) > 0) & (cv2.erode(mask, wide) == 0)
    photo, shown = (float(_edges(picture)[rim].mean()) for picture in (comparison.photo, comparison.shown))
    if photo > _EDGE_RATIO * shown:
        return "new"
    return "missing" if shown > _EDGE_RATIO * photo else "changed"


def _edges(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    soft = cv2.GaussianBlur(picture, (0, 0), 1.5)
    across, down = (cv2.Sobel(soft, cv2.CV_32F, 1 - axis, axis) for axis in (0, 1))
    return np.asarray(np.sqrt(across**2 + down**2).max(axis=2), np.float32)
