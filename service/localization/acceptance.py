"""Whether a pose is to be believed: how many keypoints agree, how widely they are spread, and whether the scene looks
from there as the photo does."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.localization.photometric_refinement import Comparison
from fastsplat_contract.localize_messages import LocalizeRefusal

FEWEST_KEYPOINTS = 30
LEAST_INLIERS = 15
"""Keypoints that agree with the pose."""
LEAST_SPREAD = 0.02
LEAST_AGREEMENT = 0.30
"""Where hardly more than the least keypoints agree; of `MANY_INLIERS` the half is enough."""
MANY_INLIERS = 60

_WINDOW = 15
_TEXTURE = 0.02
"""Standard deviation of gray values in a window from which on it can be compared."""
_LEAST_WINDOWS = 0.01


@dataclass(frozen=True)
class Evidence:
    """What speaks for a pose.

    Attributes:
        inliers: keypoints of the photo that agree with it.
        inlier_share: of the keypoints that were matched at all, 0..1.
        spread: share of the picture inside the convex hull of those that agree, 0..1.
        agreement: how like the scene's picture from there is to the photo, -1..1, see `agreement_of`; None where too
            little of the picture can be compared.
    """

    inliers: int
    inlier_share: float
    spread: float
    agreement: float | None


def refusal_of(evidence: Evidence) -> LocalizeRefusal | None:
    """Why a pose is not to be believed; None where it is. The thresholds were chosen on other scenes, see
    docs/measuring.md."""
    if evidence.inliers < LEAST_INLIERS:
        return "few_matches"
    if evidence.spread < LEAST_SPREAD:
        return "narrow"
    sure = min(1.0, (evidence.inliers - LEAST_INLIERS) / (MANY_INLIERS - LEAST_INLIERS))
    least = LEAST_AGREEMENT * (1 - 0.5 * sure)
    if evidence.agreement is None:  # a plain or hardly covered view: only many matches speak for it
        return None if evidence.inliers >= MANY_INLIERS else "looks_different"
    return "looks_different" if evidence.agreement < least else None


def explanation_of(refusal: LocalizeRefusal | None, evidence: Evidence) -> str:
    """A sentence for people."""
    agreement = "cannot be compared" if evidence.agreement is None else f"agrees by {evidence.agreement:.2f} of 1"
    if refusal is None:
        return f"{evidence.inliers} places of the photo agree with the pose, and the scene's picture {agreement}."
    return {
        "no_keypoints": "The photo has hardly any detail that could be known again: it is blurred, dark or plain.",
        "few_matches": f"Only {evidence.inliers} places of the photo were found together in the scene, fewer than "
        f"{LEAST_INLIERS}: it shows another place, or this one from where no photo of the scene was taken.",
        "narrow": f"The {evidence.inliers} places of the photo that were found in the scene are close together in it, "
        "so that a pose from them would not be sure.",
        "looks_different": f"{evidence.inliers} places of the photo were found in the scene, but the scene's picture "
        f"from there {agreement}: it shows another place, or one that has changed a lot.",
    }[refusal]


def spread_of(pixels: NDArray[np.float64], size: tuple[int, int]) -> float:
    """Share of a picture (width, height) inside the convex hull of pixels [N, 2], 0..1."""
    if len(pixels) < 3:
        return 0.0
    hull = cv2.convexHull(pixels.astype(np.float32))
    return float(min(1.0, cv2.contourArea(hull) / (size[0] * size[1])))


def agreement_of(comparison: Comparison) -> float | None:
    """-1..1: mean of the normalized cross-correlation of gray values in covered windows of 15 by 15 pixels with
    something to see, each with its own mean and contrast; None where there are hardly any."""
    photo, shown = (_gray(picture) for picture in (comparison.photo, comparison.shown))
    covered = comparison.covered.astype(np.float32)
    inside = cv2.boxFilter(covered, -1, (_WINDOW, _WINDOW), borderType=cv2.BORDER_CONSTANT) > 0.8
    mean_p, mean_s = _mean(photo), _mean(shown)
    var_p, var_s = _mean(photo * photo) - mean_p**2, _mean(shown * shown) - mean_s**2
    both = _mean(photo * shown) - mean_p * mean_s
    textured = inside & (np.maximum(var_p, var_s) > _TEXTURE**2)
    if textured.mean() < _LEAST_WINDOWS:
        return None
    floor = (_TEXTURE / 2) ** 2
    correlation = both / np.sqrt(np.maximum(var_p, floor) * np.maximum(var_s, floor))
    return float(correlation[textured].clip(-1, 1).mean())


def _gray(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    gray = cv2.GaussianBlur(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), (0, 0), 1.5)
    return np.asarray(gray, np.float32)


def _mean(values: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(cv2.boxFilter(values, cv2.CV_32F, (_WINDOW, _WINDOW)), np.float32)
