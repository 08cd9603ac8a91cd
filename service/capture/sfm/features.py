"""Extracts SIFT features (Lowe, IJCV 2004). Runs only in the child process of `service.capture.untrusted.sandbox`.

OpenCV's implementation takes a third of the time of COLMAP's. Threads extract whole images, so nothing depends on their
number.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

_CONTRAST, _EDGE = 0.01, 10.0
"""Thresholds of COLMAP; of the contrast OpenCV takes a third."""
_ENOUGH = 0.5
"""Share of the requested features from which on the finest octave, which takes most of the time, is left out."""


def extract_features(
    database: Path, images: Path, files: list[str], masks: Path | None, request: dict[str, int], threads: int
) -> None:
    """Writes features of images to a database, for masked ones where the mask is positive.

    Args:
        masks: folder with `<file>.png` for masked images; None: none is masked.
        request: "sfm_max_side", pixels of the longer side at most, and "sfm_features", an image.
    """
    cv2.setNumThreads(1)

    def extract(file: str) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        path = None if masks is None else masks / f"{file}.png"
        mask = None if path is None or not path.is_file() else _read(path)
        return _features(_read(images / file), mask, request["sfm_max_side"], request["sfm_features"])

    with pycolmap.Database.open(database) as writer, ThreadPoolExecutor(threads) as pool:
        ids = {image.name: image.image_id for image in writer.read_all_images()}
        for file, (keypoints, descriptors) in zip(files, pool.map(extract, files), strict=True):
            writer.write_keypoints(ids[file], keypoints)
            kind = pycolmap.FeatureExtractorType.SIFT
            writer.write_descriptors(ids[file], pycolmap.FeatureDescriptors(kind, descriptors))


def _read(path: Path) -> NDArray[np.uint8]:
    gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert gray is not None
    return np.asarray(gray, np.uint8)


def _features(
    gray: NDArray[np.uint8], mask: NDArray[np.uint8] | None, max_side: int, count: int
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Finds the largest features: x, y, scale and orientation, float32 [F, 4], and descriptors, uint8 [F, 128]."""
    sift = cv2.SIFT.create(0, 3, _CONTRAST, _EDGE, 1.6, True)
    factor = min(1.0, max_side / max(gray.shape))
    # OpenCV doubles the image first, which at half the size gives the octaves from the image's own on.
    for share, enough in ((0.5, _ENOUGH * count), (1.0, 0)):
        small = _resized(gray, factor * share)
        at, found = sift.detectAndCompute(small, None if mask is None else _resized(mask, factor * share))
        if len(at) >= enough:
            break
    if found is None:
        return np.zeros((0, 4), np.float32), np.zeros((0, 128), np.uint8)
    sizes = np.array([point.size for point in at])
    largest = np.argsort(-sizes, kind="stable")[:count]
    zoom = np.array(gray.shape[::-1]) / small.shape[::-1]
    places = (np.asarray(cv2.KeyPoint.convert(at)) + 0.5) * zoom
    shapes = [sizes / 2 * zoom[0], np.radians([point.angle for point in at])]
    rooted = np.sqrt(found / np.maximum(found.sum(axis=1, keepdims=True), 1e-9))  # Arandjelović, Zisserman, CVPR 2012
    descriptors = np.clip(np.round(512 * rooted), 0, 255).astype(np.uint8)
    return np.column_stack([places, *shapes]).astype(np.float32)[largest], descriptors[largest]


def _resized(pixels: NDArray[np.uint8], factor: float) -> NDArray[np.uint8]:
    size = [max(1, round(side * factor)) for side in pixels.shape[::-1]]
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
