"""Estimates meters from printed AprilTags of a known side.

Corners (ArUco, family 36h11) are triangulated over the views, and the sides of the squares compared with the printed
side. A jackknife over the views gives the uncertainty, which covers errors of corners and poses alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import Capture, ScaleEstimate
from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.capture.world.scale_estimates import metric_capture
from fastsplat_contract.geometry.camera import PosedCamera

_TAG_SIDE_ERROR_M = 0.0002  # 1 σ of the side, by printer and ruler; part of every stated interval

F64 = NDArray[np.float64]

TAG_FAMILY = cv2.aruco.DICT_APRILTAG_36h11
TAG_COUNT = 587  # of the family
_LEAST_VIEWS = 3
_MOST_ERROR_PX = 1.5
_MOST_RELATIVE = 0.05
"""Largest half of a relative 95 % interval that is stated."""
_STEPS = 8


@dataclass(frozen=True)
class TagSighting:
    """A tag in a view."""

    view: int  # index
    tag: int  # id in its family
    corners: F64  # [4, 2] pixels, clockwise from the tag's top left, pixel centers at +0.5


def find_tags(gray: NDArray[np.uint8], view: int, tags: range) -> list[TagSighting]:
    """Finds tags with ids in `tags` in an undistorted gray picture, without ambiguous duplicates."""
    if not any(number in tags for number, _ in _detected(gray, cv2.aruco.CORNER_REFINE_NONE)):
        return []
    # Lines fitted to the edges: other refinements pull corners of small tags inwards, by 1 to 4 % of the side. It takes
    # four times as long as detection, so only for pictures with tags. Pixel centers are at +0.5 already.
    refined = _detected(gray, cv2.aruco.CORNER_REFINE_APRILTAG)
    numbers = [number for number, _ in refined]
    return [
        TagSighting(view, number, corners)
        for number, corners in refined
        if number in tags and numbers.count(number) == 1
    ]


def _detected(gray: NDArray[np.uint8], refinement: int) -> list[tuple[int, F64]]:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = refinement
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(TAG_FAMILY), parameters)
    corners, ids, _ = detector.detectMarkers(gray)
    numbers = [] if ids is None else [int(number) for number in np.ravel(ids)]
    return [(number, quad.reshape(4, 2).astype(np.float64)) for number, quad in zip(numbers, corners, strict=True)]


def estimate_scale(
    sightings: Iterable[TagSighting], cameras: Sequence[PosedCamera], side_m: float, side_error_m: float = 0.0
) -> ScaleEstimate | None:
    """Estimates meters per scene unit from the sides of tags.

    Args:
        cameras: of the views, without distortion, in scene units.
        side_m: printed side of the black square, meters.
        side_error_m: 1 σ of that side over printers and rulers, meters.

    Returns:
        None if no tag is seen well in three views from different places, or the 95 % interval exceeds ±5 %.
    """
    by_tag: dict[int, dict[int, F64]] = {}
    for sighting in sightings:
        by_tag.setdefault(sighting.tag, {})[sighting.view] = sighting.corners
    squares = {
        tag: square
        for tag, views in by_tag.items()
        if len(views) >= _LEAST_VIEWS and (square := _square(views, cameras)) is not None
    }
    views = sorted({view for tag in squares for view in by_tag[tag]})
    if not squares or len(views) < _LEAST_VIEWS:
        return None
    side = _mean_side(squares.values())
    without = []
    for left_out in views:
        sides: list[tuple[float, float]] = []
        for tag, square in squares.items():
            rest = {view: corners for view, corners in by_tag[tag].items() if view != left_out}
            again = square if len(rest) == len(by_tag[tag]) else _square(rest, cameras) if len(rest) > 1 else None
            if again is not None:
                sides.append(again)
        if sides:
            without.append(_mean_side(sides))
    count = len(without)
    if count < _LEAST_VIEWS:
        return None
    # Costs 40 MB, only for captures with tags.
    from scipy.stats import t as student_t

    spread = np.asarray(without) / side
    variance = (count - 1) / count * float(((spread - spread.mean()) ** 2).sum())
    deviation = float(np.hypot(np.sqrt(variance), side_error_m / side_m))
    half = float(student_t.ppf(0.975, count - 1)) * deviation
    if not half <= _MOST_RELATIVE:
        return None
    return ScaleEstimate("tags", side_m / side, half)


def in_meters(capture: Capture, settings: CaptureSettings, report: Callable[[int], None]) -> Capture:
    """Scales a capture to meters by tags and earlier estimates; unchanged without tags."""
    if settings.tag_side_m is None:
        return capture
    sightings = []
    for index, view in enumerate(capture.views):
        report(index)
        gray = np.asarray(cv2.cvtColor(load_rgb(view.image_path), cv2.COLOR_RGB2GRAY), np.uint8)
        sightings += find_tags(gray, index, range(settings.first_tag, settings.last_tag + 1))
    cameras = [view.posed for view in capture.views]
    scale = estimate_scale(sightings, cameras, settings.tag_side_m, _TAG_SIDE_ERROR_M)
    return capture if scale is None else metric_capture(capture, scale)


def draw_tag(tag: int, modules_px: int) -> NDArray[np.uint8]:
    """Draws a tag with its white border, 10 modules of `modules_px` pixels a side."""
    dictionary = cv2.aruco.getPredefinedDictionary(TAG_FAMILY)
    black = cv2.aruco.generateImageMarker(dictionary, tag, 8 * modules_px)
    return np.asarray(np.pad(black, modules_px, constant_values=255), np.uint8)


def _mean_side(squares: Iterable[tuple[float, float]]) -> float:
    """Averages sides, weighted by inverse variances."""
    sides, variances = np.array(list(squares)).T
    return float(np.average(sides, weights=1 / np.maximum(variances, 1e-30)))


def _square(views: Mapping[int, F64], cameras: Sequence[PosedCamera]) -> tuple[float, float] | None:
    """Computes a tag's side in scene units and its variance; None if the views contradict."""
    corners, covariances, errors = [], [], []
    for corner in range(4):
        seen = [(cameras[view], points[corner]) for view, points in views.items()]
        solution = _triangulate(seen)
        if solution is None:
            return None
        point, covariance, error = solution
        corners.append(point)
        covariances.append(covariance)
        errors.append(error)
    if max(errors) > _MOST_ERROR_PX:
        return None
    sides, variances = [], []
    for corner in range(4):
        edge = corners[corner] - corners[corner - 1]
        length = float(np.linalg.norm(edge))
        if length == 0:
            return None
        sides.append(length)
        variances.append(float(edge @ (covariances[corner] + covariances[corner - 1]) @ edge) / length**2)
    return float(np.mean(sides)), float(np.mean(variances)) / 2  # neighboring sides share a corner


def _triangulate(seen: Sequence[tuple[PosedCamera, F64]]) -> tuple[F64, F64, float] | None:
    """Triangulates a point by least squares (Gauss-Newton from the rays' nearest point).

    Returns its covariance, by the size of the residuals, and their root mean square in pixels, too.
    """
    poses = np.stack([posed.camera_from_world() for posed, _ in seen]).astype(np.float64)
    intrinsics = np.array([(c.fx, c.fy, c.cx, c.cy) for c in (posed.camera for posed, _ in seen)])
    pixels = np.stack([pixel for _, pixel in seen])
    focal, center = intrinsics[:, :2], intrinsics[:, 2:]
    rays = np.concatenate([(pixels - center) / focal, np.ones((len(seen), 1))], axis=1)
    rotations, translations = poses[:, :3, :3], poses[:, :3, 3]
    directions = np.einsum("nji,nj->ni", rotations, rays)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = -np.einsum("nji,nj->ni", rotations, translations)
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    normal = across.sum(0)
    if np.linalg.cond(normal) > 1e12:
        return None
    point = np.linalg.solve(normal, np.einsum("nij,nj->i", across, origins))
    for _ in range(_STEPS):
        local = rotations @ point + translations
        if (local[:, 2] <= 0).any():
            return None
        residual = local[:, :2] / local[:, 2:] * focal + center - pixels
        slopes = (local[:, :2] / local[:, 2:])[..., None]
        flat = ((focal / local[:, 2:])[..., None] * (rotations[:, :2] - slopes * rotations[:, 2:])).reshape(-1, 3)
        hessian = flat.T @ flat
        if np.linalg.cond(hessian) > 1e12:
            return None
        step = np.linalg.solve(hessian, flat.T @ residual.reshape(-1))
        point = point - step
    squares = float((residual**2).sum())
    variance = squares / max(1, 2 * len(seen) - 3)
    return np.asarray(point), np.asarray(np.linalg.inv(hessian) * variance), float(np.sqrt(squares / len(seen)))
