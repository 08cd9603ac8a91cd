"""Judges photos by sharpness, brightness, duplicates and matches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.formats.reduced_images import limited
from fastsplat_contract.photos.photo_verdicts import NotPlaced, PhotoDefect, PhotoVerdict

_SIDE = 800
_THUMBNAIL = 16
_MIN_SHARPNESS = 0.5
_MIN_CRISPNESS = 0.6
_MIN_SET = 3
_MIN_BRIGHTNESS = 0.16
_SAME_PIXELS = 3.0
_SAME_PLACE = 0.01
_SAME_DIRECTION = float(np.cos(np.radians(1.0)))
_MIN_FEATURES = 50
MIN_MATCHES = 15
"""COLMAP's least number of verified matches of a pair."""
_ROWS = 512


@dataclass(frozen=True, eq=False)
class PhotoQuality:
    """Pixel statistics of a photo, from gray values at 800 pixels on the longer side."""

    name: str
    detail: float  # standard deviation of the Laplacian
    """Falls with blur (Pech-Pacheco et al., "Diatom autofocusing in brightfield microscopy", ICPR 2000)."""
    contrast: float  # standard deviation, 0..255
    brightness: float  # 90th percentile, 0..1
    thumbnail: NDArray[np.float32]  # [256], 16×16 gray values


@dataclass(frozen=True)
class PhotoMatches:
    """Matching statistics of a photo."""

    features: int
    best: int  # verified matches with its best partner
    other_model: bool  # in another model than the scene's
    nearest_placed: str = ""  # placed photo with most matches, verified ones first


def matches_by_name(rows: Mapping[str, Sequence[Any]], names: Mapping[str, str]) -> dict[str, PhotoMatches]:
    """Converts matches of `sfm.reconstruct` from files to photo names."""
    matches = {}
    for file, (features, best, other_model, nearest) in rows.items():
        matches[names[file]] = PhotoMatches(features, best, other_model, names.get(nearest, ""))
    return matches


def measure_photo(name: str, pixels: NDArray[np.uint8]) -> PhotoQuality:
    """Measures uint8 [H, W, 3] RGB; takes some milliseconds."""
    gray = limited(np.ascontiguousarray(pixels[..., 1]), _SIDE)  # green is the sharpest channel and close to luminance
    detail = float(cv2.Laplacian(gray, cv2.CV_16S).std())
    thumbnail = cv2.resize(gray.astype(np.float32), (_THUMBNAIL, _THUMBNAIL), interpolation=cv2.INTER_AREA)
    return PhotoQuality(
        name=name,
        detail=detail,
        contrast=float(gray.std()),
        brightness=float(np.percentile(gray, 90)) / 255,
        thumbnail=np.asarray(thumbnail, dtype=np.float32).ravel(),
    )


def judge_photos(
    photos: Sequence[PhotoQuality],
    poses: Mapping[str, NDArray[np.float64]],
    matches: Mapping[str, PhotoMatches] | None,
    reasons: Mapping[str, NotPlaced] | None = None,
) -> tuple[PhotoVerdict, ...]:
    """Makes one verdict per photo, sorted by name.

    Args:
        poses: world_from_camera [4, 4] of placed photos, by name.
        matches: by name; None if poses came with the upload.
        reasons: known reasons of unplaced photos, by name; also of unreadable ones.
    """
    reasons = reasons or {}
    ordered = sorted(photos, key=lambda photo: photo.name)
    sharpness = _relative(np.array([photo.detail for photo in ordered]))
    crispness = _relative(np.array([photo.detail / max(photo.contrast, 1.0) for photo in ordered]))
    originals = _originals(ordered, poses)
    verdicts = []
    for photo, sharp, crisp in zip(ordered, sharpness, crispness, strict=True):
        blurred = len(ordered) >= _MIN_SET and sharp < _MIN_SHARPNESS and crisp < _MIN_CRISPNESS
        dark = photo.brightness < _MIN_BRIGHTNESS
        original = originals.get(photo.name, "")
        flags: Mapping[PhotoDefect, bool] = {"blurred": blurred, "dark": dark, "duplicate": bool(original)}
        shared = None if matches is None else matches.get(photo.name)
        placed = photo.name in poses
        reason = None if placed else reasons.get(photo.name) or _reason(shared)
        defects = tuple(name for name, present in flags.items() if present)
        joins = reason in _JOINED_BY_MORE and shared is not None and shared.nearest_placed
        between = (shared.nearest_placed, photo.name) if joins and shared else ()
        verdicts.append(
            PhotoVerdict(
                name=photo.name,
                placed=placed,
                not_placed=reason,
                defects=defects,
                duplicate_of=original,
                sharpness=round(float(sharp), 3),
                brightness=round(photo.brightness, 3),
                matches=None if shared is None else shared.best,
                advice=advice_of(reason, defects, original, between),
                between=between,
            )
        )
    unread = reasons.keys() - {photo.name for photo in ordered}
    for name in unread:
        advice = advice_of(reasons[name], (), "")
        verdicts.append(PhotoVerdict(name, False, reasons[name], (), "", 0.0, 0.0, None, advice))
    return tuple(sorted(verdicts, key=lambda verdict: verdict.name))


def _relative(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Divides values by their median."""
    middle = float(np.median(values)) if len(values) else 0.0
    return np.asarray(values / middle) if middle > 0 else np.ones_like(values)


def _originals(photos: Sequence[PhotoQuality], poses: Mapping[str, NDArray[np.float64]]) -> dict[str, str]:
    """Maps duplicates to the sharpest photo of the same view."""
    order = sorted(photos, key=lambda photo: (-round(photo.detail, 2), photo.name))
    thumbnails = np.stack([photo.thumbnail for photo in order]) if order else np.zeros((0, _THUMBNAIL**2), np.float32)
    squares = (thumbnails**2).sum(axis=1)
    reach = _SAME_PLACE * _extent(poses)
    originals: dict[str, str] = {}
    for begin in range(0, len(order), _ROWS):
        rows = slice(begin, begin + _ROWS)
        distances = squares[rows, None] + squares[None] - 2 * thumbnails[rows] @ thumbnails.T
        near = distances < thumbnails.shape[1] * _SAME_PIXELS**2
        for row, number in enumerate(range(begin, min(begin + _ROWS, len(order)))):
            for index in np.flatnonzero(near[row, :number]):
                photo, candidate = order[number], order[int(index)]
                if candidate.name not in originals and _same_pose(photo.name, candidate.name, poses, reach):
                    originals[photo.name] = candidate.name
                    break
    return originals


def _extent(poses: Mapping[str, NDArray[np.float64]]) -> float:
    """Extent of the cameras in scene units."""
    if len(poses) < 2:
        return float("inf")
    centers = np.stack([pose[:3, 3] for pose in poses.values()])
    return float(np.linalg.norm(np.ptp(centers, axis=0)))


def _same_pose(first: str, second: str, poses: Mapping[str, NDArray[np.float64]], reach: float) -> bool:
    """Checks if two photos may have about the same pose; unknown poses may."""
    if first not in poses or second not in poses:
        return True
    pose, other_pose = poses[first], poses[second]
    if float(np.linalg.norm(pose[:3, 3] - other_pose[:3, 3])) > reach:
        return False
    return float((pose[:3, 2] * other_pose[:3, 2]).sum()) >= _SAME_DIRECTION


def _reason(matches: PhotoMatches | None) -> NotPlaced:
    if matches is None:
        return "unknown"
    if matches.features < _MIN_FEATURES:
        return "few_features"
    if matches.other_model:
        return "other_model"
    return "no_overlap" if matches.best < MIN_MATCHES else "few_matches"


_REASONS: Mapping[NotPlaced, str] = {
    "few_features": "It shows hardly any texture: take in more than bare walls, sky or glass.",
    "no_overlap": "It shares nothing with the other photos: take more between it and them, overlapping by two thirds.",
    "few_matches": "It shares too little with the others: take more photos around it, with smaller steps between them.",
    "other_model": "It belongs to a group of photos that shares nothing with the scene: take photos that join the two, "
    "or post the group as a scene of its own.",
    "masked": "Its mask leaves no pixel: in a mask, 0 is what to ignore.",
    "unknown": "Structure from motion found no place for it.",
    "lens": "Its lens could not be worked out from this photo alone: send it as the camera stored it, neither cropped "
    "nor edited, or leave it out.",
    "unreadable": "It cannot be read to its end: copy it from the camera again, or leave it out.",
}
_JOINED_BY_MORE = frozenset({"few_features", "no_overlap", "few_matches", "other_model", "unknown"})
"""Reasons that one more photo can remedy."""
_DEFECTS: Mapping[PhotoDefect, str] = {
    "blurred": "It is much less sharp than the others: hold the camera still, or take it again.",
    "dark": "It is nearly black: add light, or expose longer.",
    "duplicate": "It shows the same as {original}, from the same place: it adds nothing; take a step between photos.",
}


def advice_of(
    reason: NotPlaced | None, defects: Sequence[PhotoDefect], original: str, between: Sequence[str] = ()
) -> str:
    """Advises on a photo, defects first, as they are often why it has no place."""
    sentences = [_DEFECTS[defect].replace("{original}", original) for defect in defects]
    if reason is not None and not {"blurred", "dark"} & set(defects):
        sentences.append(_REASONS[reason])
        if between:
            sentences.append(f"One taken between {between[0]} and this one would help most.")
    return " ".join(sentences)
