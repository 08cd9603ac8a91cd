"""Detects and describes keypoints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

DESCRIPTOR_BYTES = 128
_CONTRAST = 0.015
"""OpenCV's default 0.04 finds too few in a room's shadows."""
_UNIT = 512.0
"""Bytes per unit of a descriptor of length 1; values above 0.498 are clipped."""


@dataclass(frozen=True)
class Keypoints:
    """K keypoints, the strongest first."""

    points: NDArray[np.float32]  # [K, 2], x and y in pixels, centers at +0.5
    descriptors: NDArray[np.uint8]  # [K, 128], RootSIFT

    def __len__(self) -> int:
        return len(self.points)


NO_KEYPOINTS = Keypoints(np.zeros((0, 2), np.float32), np.zeros((0, DESCRIPTOR_BYTES), np.uint8))


def find_keypoints(picture: NDArray[np.uint8], most: int) -> Keypoints:
    """Detects SIFT features (Lowe, IJCV 2004) in RGB, as RootSIFT (Arandjelović and Zisserman, CVPR 2012)."""
    gray = np.ascontiguousarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))
    detector = cv2.SIFT.create(most, contrastThreshold=_CONTRAST, enable_precise_upscale=True)
    found, histograms = detector.detectAndCompute(gray, None)
    if histograms is None or not len(found):
        return NO_KEYPOINTS
    order = np.argsort([-keypoint.response for keypoint in found], kind="stable")[:most]
    points = np.array([found[row].pt for row in order], np.float32) + 0.5
    rows = np.asarray(histograms, np.float32)[order]
    roots = np.sqrt(rows / np.maximum(rows.sum(axis=1, keepdims=True), 1e-6))
    return Keypoints(points, np.asarray((roots * _UNIT).round().clip(0, 255), np.uint8))


def unit_rows(descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Normalizes stored descriptors to length 1, float32 [K, 128]."""
    rows = descriptors.astype(np.float32)
    lengths: NDArray[Any] = np.sqrt(np.einsum("ij,ij->i", rows, rows))
    return np.asarray(rows / np.maximum(lengths, 1e-6)[:, None], np.float32)
