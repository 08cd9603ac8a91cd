"""Estimates meters by GPS places of photos against their poses.

Only lengths come out: no coordinate is stored with a capture, a scene or an error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.captures import Capture, ScaleEstimate
from fastsplat.service.capture.photos.photo_metadata import PhotoPlace
from fastsplat.service.capture.world.scale_estimates import metric_capture

F64 = NDArray[np.float64]

_ASSUMED_M = 5.0  # accuracy where none is stated, as of phones under an open sky
_LEAST_M = 0.5  # best accuracy that is believed
_RADIUS_TO_DEVIATION = 1 / 1.51  # radius that holds 68 % of places to 1 σ along each axis
_LEAST_PLACES = 5
_LEAST_SPREAD = 4.0  # of the places, in accuracies
_MOST_RELATIVE = 0.2
_MOST_TILT_DEG = 6.0  # lengths in the plane shrink by its cosine
_OUTLIER = 4.0
_ROUNDS = 5
_MOST_CORRELATION = 0.8
_EQUATOR_M, _FLATTENING = 6_378_137.0, 1 / 298.257223563


@dataclass(frozen=True)
class PlacedPhoto:
    """A camera with its GPS place."""

    center: F64  # [3], in a world with z up
    place: PhotoPlace


def local_meters(places: Sequence[PhotoPlace]) -> F64:
    """Converts places to east and north of their median, meters, [N, 2] (WGS84, first order)."""
    degrees = np.array([(place.latitude_deg, place.longitude_deg) for place in places])
    middle = np.median(degrees, axis=0)
    turn = (degrees[:, 1] - middle[1] + 180) % 360 - 180  # over the date line
    latitude, squared = np.radians(middle[0]), _FLATTENING * (2 - _FLATTENING)
    bend = 1 - squared * np.sin(latitude) ** 2
    north = np.radians(degrees[:, 0] - middle[0]) * _EQUATOR_M * (1 - squared) / bend**1.5
    east = np.radians(turn) * _EQUATOR_M * np.cos(latitude) / np.sqrt(bend)
    return np.stack([east, north], axis=1)


def estimate_gps_scale(photos: Sequence[PlacedPhoto]) -> tuple[ScaleEstimate | None, str]:
    """Estimates meters per scene unit from photos' places; None with the reason for people.

    A similarity in the plane, a·c + t, is fitted to east and north by least squares without places more than 4 σ off;
    its scale is |a|. Its variance is σ² / Σ|c - c̄|², σ² the larger of the residuals' and of the stated accuracy's,
    times (1 + ρ) / (1 - ρ), ρ the correlation of residuals of neighbors.

    Args:
        photos: in the order in which they were taken.
    """
    if not photos:
        return None, ""
    places = [photo.place for photo in photos]
    stated = [place.accuracy_m for place in places if place.accuracy_m is not None]
    radius = max(_LEAST_M, float(np.median(stated)) if len(stated) * 2 > len(places) else _ASSUMED_M)
    accuracy = f"{radius:.2g} m" if len(stated) * 2 > len(places) else f"{radius:.2g} m, which is assumed"
    meters = local_meters(places)
    spread = float(np.sqrt(((meters - meters.mean(axis=0)) ** 2).sum(axis=1).mean()))
    if len(photos) < _LEAST_PLACES or spread < _LEAST_SPREAD * radius:
        return None, (
            f"The GPS places of {len(photos)} photos do not tell how long a unit is: they are spread over "
            f"{spread:.1f} m, and are accurate to {accuracy}."
        )
    scene = np.array([photo.center[0] + 1j * photo.center[1] for photo in photos])
    world = meters[:, 0] + 1j * meters[:, 1]
    deviation = radius * _RADIUS_TO_DEVIATION
    used = np.ones(len(photos), bool)
    for _ in range(_ROUNDS):
        centered, target = scene - scene[used].mean(), world - world[used].mean()
        extent = float((np.abs(centered[used]) ** 2).sum())
        if extent == 0:
            return None, "The photos were placed at one point, which has no length."
        factor = complex((centered[used].conj() @ target[used]) / extent)
        residual = target - factor * centered
        measured = float(np.median(np.abs(residual[used]))) / 1.1774  # of a Rayleigh distribution
        inliers = np.abs(residual) <= _OUTLIER * max(deviation, measured)
        if inliers.sum() < _LEAST_PLACES or (inliers == used).all():
            break
        used = inliers
    count, scale = int(used.sum()), abs(factor)
    # Costs 40 MB, only for captures with places.
    from scipy.stats import t as student_t

    freedom = 2 * count - 4
    variance = max(float((np.abs(residual[used]) ** 2).sum()) / freedom, deviation**2)
    variance *= _alike(residual[used])
    half = float(student_t.ppf(0.975, freedom)) * float(np.sqrt(variance / extent)) / scale if scale > 0 else np.inf
    if count < max(_LEAST_PLACES, 0.6 * len(photos)) or not half <= _MOST_RELATIVE:
        return None, (
            "The photos' GPS places contradict where the photos were taken from by their pictures, or each other: they "
            "do not tell how long a unit is."
        )
    return ScaleEstimate("gps", scale, half), ""


def with_gps(capture: Capture, places: Sequence[PhotoPlace | None]) -> Capture:
    """Scales a capture to meters by GPS, combined with tags; otherwise adds a warning.

    Args:
        capture: with z up, by structure from motion.
        places: of its views; None if unknown, or not the first view of a photo.
    """
    photos = [
        PlacedPhoto(view.posed.world_from_camera[:3, 3], place)
        for view, place in zip(capture.views, places, strict=True)
        if place is not None
    ]
    vertical = capture.report.vertical
    estimate, reason = estimate_gps_scale(photos)
    if estimate is not None and (vertical is None or vertical.deviation_deg > _MOST_TILT_DEG):
        estimate, reason = None, "The photos' GPS places are not used: it is not known well enough which way is up."
    if estimate is None:
        warnings = (*capture.report.warnings, *([reason] if reason else []))
        return replace(capture, report=replace(capture.report, warnings=warnings))
    return metric_capture(capture, estimate)


def _alike(residual: NDArray[np.complex128]) -> float:
    """Variance inflation of a mean if errors of neighbors correlate (first-order autoregression)."""
    power = float((np.abs(residual) ** 2).sum())
    if power == 0:
        return 1.0
    correlation = float((residual[:-1].conj() @ residual[1:]).real) / power
    correlation = min(max(correlation, 0.0), _MOST_CORRELATION)
    return (1 + correlation) / (1 - correlation)
