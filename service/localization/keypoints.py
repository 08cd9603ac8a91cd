"""Places in a picture that are known again by their surroundings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

DESCRIPTOR_BYTES = 128
_CONTRAST = 0.015
"""Of OpenCV's 0.04 too few places are left in a room's shadows."""
_UNIT = 512.0
"""A stored byte of a descriptor of length 1 is so many times its value; what is above 0.498 is cut to that."""


@dataclass(frozen=True)
class Keypoints:
    """K places, the strongest first.

    Attributes:
        points: float32 [K, 2], x and y in pixels of the picture, centers at +0.5.
        descriptors: uint8 [K, 128], RootSIFT.
    """

    points: NDArray[np.float32]
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points)


def find_keypoints(picture: NDArray[np.uint8], most: int) -> Keypoints:
    """The strongest SIFT features (Lowe, IJCV 2004) as RootSIFT (Arandjelović and Zisserman, CVPR 2012).

    Args:
        picture: uint8 [H, W, 3], RGB.
    """
    gray = np.ascontiguousarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))
    detector = cv2.SIFT.create(most, contrastThreshold=_CONTRAST, enable_precise_upscale=True)
    found, histograms = detector.detectAndCompute(gray, None)
    if histograms is None or not len(found):
        return Keypoints(np.zeros((0, 2), np.float32), np.zeros((0, DESCRIPTOR_BYTES), np.uint8))
    order = np.argsort([-one.response for one in found], kind="stable")[:most]
    points = np.array([found[row].pt for row in order], np.float32) + 0.5
    rows = np.asarray(histograms, np.float32)[order]
    roots = np.sqrt(rows / np.maximum(rows.sum(axis=1, keepdims=True), 1e-6))
    return Keypoints(points, np.asarray((roots * _UNIT).round().clip(0, 255), np.uint8))


def unit_rows(descriptors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """float32 [K, 128]: stored descriptors, of length 1."""
    rows = descriptors.astype(np.float32)
    lengths: NDArray[Any] = np.sqrt(np.einsum("ij,ij->i", rows, rows))
    return np.asarray(rows / np.maximum(lengths, 1e-6)[:, None], np.float32)
