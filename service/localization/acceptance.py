"""Accepts or refuses poses by inliers, their spread, and how well scene and photo agree."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.localization.photometric_refinement import Comparison
from fastsplat_contract.photos.localization import LocalizeRefusal

FEWEST_KEYPOINTS = 30
LEAST_INLIERS = 15
LEAST_SPREAD = 0.02
LEAST_AGREEMENT = 0.30
"""Limit at the fewest inliers; it falls linearly to half at `MANY_INLIERS`."""
MANY_INLIERS = 60

_WINDOW = 15
_TEXTURE = 0.02  # least standard deviation of gray values in a comparable window
_LEAST_WINDOWS = 0.01


@dataclass(frozen=True)
class Evidence:
    """Evidence for a pose."""

    inliers: int  # keypoints of the photo
    inlier_share: float  # of the matched keypoints, 0..1
    spread: float  # see `spread_of`
    agreement: float | None  # see `agreement_of`


def refusal_of(evidence: Evidence) -> LocalizeRefusal | None:
    """Decides why to refuse a pose; None: accepted. Thresholds: docs/measuring.md."""
    if evidence.inliers < LEAST_INLIERS:
        return "few_matches"
    if evidence.spread < LEAST_SPREAD:
        return "narrow"
    sure = min(1.0, (evidence.inliers - LEAST_INLIERS) / (MANY_INLIERS - LEAST_INLIERS))
    least = LEAST_AGREEMENT * (1 - 0.5 * sure)
    if evidence.agreement is None:  # a plain or hardly covered view: accepted only with many matches
        return None if evidence.inliers >= MANY_INLIERS else "looks_different"
    return "looks_different" if evidence.agreement < least else None


def explanation_of(refusal: LocalizeRefusal | None, evidence: Evidence) -> str:
    """Explains an acceptance or refusal in a sentence for people."""
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
    """Compares photo and scene by normalized cross-correlation, -1..1.

    Averages over covered, textured windows of 15 × 15 gray pixels, each normalized by its own mean and contrast; None
    if there are too few.
    """
    photo, scene = (_gray(picture) for picture in (comparison.photo, comparison.rendering))
    covered = comparison.covered.astype(np.float32)
    inside = cv2.boxFilter(covered, -1, (_WINDOW, _WINDOW), borderType=cv2.BORDER_CONSTANT) > 0.8
    mean_p, mean_s = _mean(photo), _mean(scene)
    var_p, var_s = _mean(photo * photo) - mean_p**2, _mean(scene * scene) - mean_s**2
    both = _mean(photo * scene) - mean_p * mean_s
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
