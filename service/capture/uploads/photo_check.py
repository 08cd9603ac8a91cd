"""Checks photos before upload or training: number, blur, darkness, duplicates, overlap."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.reduced_images import reduced_size
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.photos.photo_quality import MIN_MATCHES, advice_of, judge_photos, measure_photo
from fastsplat.service.capture.untrusted.image_decoder import ImageDecoder
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.files import link_or_copy
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.photos.photo_verdicts import NotPlaced, PhotoVerdict

_SIDE = 480
_FEATURES = 800
_RATIO = 0.75
_NEIGHBORS = 12
"""Photos before and after, by name and cyclic, that each is matched with."""
_ERROR_PX = 2.0
_FEW, _SOME = 6, 15


@dataclass(frozen=True)
class PhotoCheck:
    """Result of a photo check."""

    photos: tuple[PhotoVerdict, ...]  # by name; unplaced, with the matches of the best pair
    advice: tuple[str, ...]  # sentences about all of them
    size: tuple[int, int]  # typical width and height, pixels


def check_photos(
    folder: Path, scratch: Path, settings: CaptureSettings, on_photo: Callable[[int, int], None] | None = None
) -> PhotoCheck:
    """Checks photos as uploads are, without placing or training anything.

    Overlap is measured by ORB features that fit a fundamental matrix; structure from motion finds more.

    Args:
        on_photo: called with the numbers of finished and of all photos.

    Raises:
        InvalidInputError: no folder, or not a set of photos without poses.
        FastSplatError: as `validate_upload` and `ImageDecoder.photo`.
    """
    if not (folder.is_dir() and any(folder.iterdir())):
        raise InvalidInputError(f"{folder} is no folder, or empty", field="photos", hint="Name a folder of photos.")
    raw = scratch / "photos"
    shutil.copytree(folder, raw, copy_function=link_or_copy, symlinks=False)
    manifest, files = read_manifest(validate_upload(raw, settings).folder)
    if manifest.source != "images":
        raise InvalidInputError(
            f"{folder} is read as {manifest.source}", field="photos", hint="Name a folder of photos alone."
        )
    decoder_folder = scratch / "decoding"
    decoder_folder.mkdir()
    qualities, features = [], []
    with ImageDecoder(decoder_folder, (files,), settings) as decoder:
        for number, (photo, name) in enumerate(zip(manifest.photos, manifest.names, strict=True)):
            if on_photo is not None:
                on_photo(number, len(manifest.photos))
            pixels = decoder.photo(files, photo, reduced_size(*photo.upright_size, settings.max_side))
            qualities.append(measure_photo(name, pixels))
            features.append(_features(pixels))
    best = _best_matches(features)
    names = [quality.name for quality in qualities]
    matches = dict(zip(names, best, strict=True))
    verdicts = []
    for verdict in judge_photos(qualities, {}, None):
        alone = len(names) > 1 and matches[verdict.name] < MIN_MATCHES
        reason: NotPlaced | None = "no_overlap" if alone else None
        advice = advice_of(reason, verdict.defects, verdict.duplicate_of)
        verdicts.append(replace(verdict, not_placed=reason, matches=matches[verdict.name], advice=advice))
    sizes = sorted(photo.upright_size for photo in manifest.photos)
    left_out = [f"left out: {name}: {reason}" for name, reason in manifest.left_out.items()]
    return PhotoCheck(tuple(verdicts), (*left_out, *_advice(verdicts)), sizes[len(sizes) // 2])


def _advice(photos: Sequence[PhotoVerdict]) -> list[str]:
    different = sum("duplicate" not in photo.defects for photo in photos)
    usable = sum(not photo.defects and photo.not_placed is None for photo in photos)
    sentences = []
    if different < _SOME:
        few = "too few for a scene" if different < _FEW else "few"
        sentences.append(
            f"{different} different photos are {few}: take 20 to 200, a small step to the side between one and the "
            "next, from all around."
        )
    if 2 * usable < len(photos):
        sentences.append(f"Only {usable} of {len(photos)} photos are without a defect: take the others again.")
    return sentences


Features = tuple[NDArray[np.float32], NDArray[np.uint8]]
"""Positions [K, 2] in pixels, and descriptors [K, 32]."""


def _features(pixels: NDArray[np.uint8]) -> Features:
    gray = np.ascontiguousarray(pixels[..., 1])
    scale = _SIDE / max(gray.shape)
    if scale < 1:
        gray = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA).astype(np.uint8)
    points, descriptors = cv2.ORB.create(_FEATURES).detectAndCompute(gray, None)
    if descriptors is None:
        return np.zeros((0, 2), np.float32), np.zeros((0, 32), np.uint8)
    return np.array([point.pt for point in points], np.float32), np.asarray(descriptors, np.uint8)


def _best_matches(features: Sequence[Features]) -> list[int]:
    """Most matches of each photo with a photo near it by name."""
    count, best = len(features), [0] * len(features)
    pairs = {
        tuple(sorted((number, (number + step) % count)))
        for number in range(count)
        for step in range(1, min(_NEIGHBORS, count - 1) + 1)
    }
    for first, second in sorted(pairs):
        shared = _shared(features[first], features[second])
        best[first], best[second] = max(best[first], shared), max(best[second], shared)
    return best


def _shared(left: Features, right: Features) -> int:
    """Counts matches that pass the ratio test and fit one fundamental matrix."""
    if min(len(left[0]), len(right[0])) < MIN_MATCHES:
        return 0
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(left[1], right[1], k=2)
    good = [pair[0] for pair in pairs if len(pair) == 2 and pair[0].distance < _RATIO * pair[1].distance]
    if len(good) < MIN_MATCHES:
        return 0
    first = np.array([left[0][match.queryIdx] for match in good])
    second = np.array([right[0][match.trainIdx] for match in good])
    cv2.setRNGSeed(0)
    _, inliers = cv2.findFundamentalMat(first, second, cv2.FM_RANSAC, _ERROR_PX, 0.99)
    return 0 if inliers is None else int(inliers.sum())
