"""Meters by GPS: the interval holds as often as it says, and where places tell nothing, nothing is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags

from fastsplat.service.capture.captures import Capture, CaptureReport, ScaleEstimate, VerticalEstimate, View
from fastsplat.service.capture.photos.photo_metadata import PhotoPlace, place_of_exif
from fastsplat.service.capture.world.gps_scale import PlacedPhoto, estimate_gps_scale, local_meters, with_gps
from fastsplat.service.capture.world.scale_estimates import combined_estimate, metric_capture
from fastsplat.service.common.combined_ratios import NORMAL_95
from fastsplat.service.scene.artefact.scaling import ScaledLength, combined
from fastsplat_contract.geometry.camera import Camera, PosedCamera

_METERS_PER_UNIT = 12.5
_LATITUDE, _LONGITUDE = 47.0, 8.0


def _places(meters: np.ndarray, accuracy_m: float | None) -> list[PhotoPlace]:
    """At east and north in meters, by the length of a degree there (World Geodetic System 1984, tabulated)."""
    north, east = meters[:, 1] / 111_170.0, meters[:, 0] / 76_055.0
    degrees = zip((_LATITUDE + north).tolist(), (_LONGITUDE + east).tolist(), strict=True)
    return [PhotoPlace(latitude, longitude, accuracy_m) for latitude, longitude in degrees]


def _walk(
    rng: np.random.Generator, count: int, width_m: float, radius_m: float, alike: float = 0.0, stated: bool = True
) -> list[PlacedPhoto]:
    """A walk around something, with places that err as their accuracy says, neighbors alike by a share."""
    turn = np.linspace(0, 1.7 * np.pi, count)
    meters = width_m / 2 * np.column_stack([np.cos(turn), 0.8 * np.sin(turn)])
    errors = rng.normal(0, radius_m / 1.51, (count, 2))
    for index in range(1, count):
        errors[index] = alike * errors[index - 1] + np.sqrt(1 - alike**2) * errors[index]
    heading = rng.uniform(0, 2 * np.pi)
    turned = meters @ np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    centers = np.column_stack([turned / _METERS_PER_UNIT, rng.normal(0, 0.02, count)])
    places = _places(meters + errors, radius_m if stated else None)
    return [PlacedPhoto(center, place) for center, place in zip(centers, places, strict=True)]


@pytest.mark.parametrize(("alike", "least"), [(0.0, 0.93), (0.5, 0.87)])
def test_the_interval_holds_as_often_as_it_says(alike: float, least: float) -> None:
    held, stated = 0, []
    for seed in range(300):
        estimate, reason = estimate_gps_scale(_walk(np.random.default_rng(seed), 40, 80.0, 4.0, alike))
        assert estimate is not None and not reason
        stated.append(estimate.relative_error_95)
        held += abs(estimate.meters_per_unit / _METERS_PER_UNIT - 1) <= estimate.relative_error_95
    assert least <= held / 300 and np.median(stated) < 0.08, "it holds, and is no wider than is of use"
    assert alike or held / 300 <= 0.99


def test_places_that_are_far_off_are_left_out() -> None:
    for seed in range(20):
        photos = _walk(np.random.default_rng(seed), 40, 80.0, 4.0)
        for row in (3, 20, 31):
            place = replace(photos[row].place, latitude_deg=_LATITUDE + 0.01)  # a kilometer
            photos[row] = PlacedPhoto(photos[row].center, place)
        estimate, _ = estimate_gps_scale(photos)
        assert estimate is not None and abs(estimate.meters_per_unit / _METERS_PER_UNIT - 1) < 0.1


def test_without_a_stated_accuracy_one_is_assumed() -> None:
    photos = _walk(np.random.default_rng(1), 40, 80.0, 1.0, stated=False)
    exact = estimate_gps_scale(_walk(np.random.default_rng(1), 40, 80.0, 1.0))[0]
    assumed = estimate_gps_scale(photos)[0]
    assert assumed is not None and exact is not None and assumed.relative_error_95 > 3 * exact.relative_error_95
    _, reason = estimate_gps_scale(_walk(np.random.default_rng(1), 40, 10.0, 1.0, stated=False))
    assert "5 m, which is assumed" in reason


def _elsewhere(centers: np.ndarray) -> list[PlacedPhoto]:
    photos = _walk(np.random.default_rng(0), 30, 90.0, 4.0)
    return [replace(photo, center=center) for photo, center in zip(photos, centers, strict=True)]


@pytest.mark.parametrize(
    ("photos", "words"),
    [
        (_walk(np.random.default_rng(0), 30, 6.0, 5.0), "spread over"),
        (_walk(np.random.default_rng(0), 4, 200.0, 5.0), "4 photos"),
        (_elsewhere(np.random.default_rng(5).normal(0, 3, (30, 3))), "contradict"),
        (_elsewhere(np.zeros((30, 3))), "one point"),
        ([], ""),
    ],
    ids=["a room", "few", "elsewhere", "one point", "none"],
)
def test_places_that_tell_nothing_are_not_used(photos: list[PlacedPhoto], words: str) -> None:
    estimate, reason = estimate_gps_scale(photos)
    assert estimate is None and words in reason and bool(reason) == bool(words)
    assert f"{_LATITUDE:.1f}" not in reason, "no coordinate is named"


def test_meters_on_the_ground() -> None:
    """Against degrees of latitude and longitude as tabulated, and over the date line."""
    meters = np.array([[0.0, 0.0], [300.0, 0.0], [0.0, 400.0]])
    local = local_meters(_places(meters, None))
    np.testing.assert_allclose(local - local[0], meters, rtol=1e-3, atol=0.01)
    beside = [PhotoPlace(0.0, 179.9995, None), PhotoPlace(0.0, -179.9995, None)]
    assert abs(np.ptp(local_meters([*beside, beside[0]])[:, 0]) - 111.3) < 0.2


def _capture(photos: list[PlacedPhoto], deviation_deg: float = 0.5, scale: ScaleEstimate | None = None) -> Capture:
    views = []
    for index, photo in enumerate(photos):
        pose = np.eye(4)
        pose[:3, 3] = photo.center
        views.append(View(PosedCamera(Camera(8, 8, 8.0, 8.0, 4.0, 4.0), pose, f"{index}.jpg"), Path(f"{index}.jpg")))
    report = CaptureReport("images", len(photos), scale=scale, vertical=VerticalEstimate("horizon", deviation_deg))
    points, colors = np.ones((3, 3), np.float32), np.zeros((3, 3), np.uint8)
    return Capture(tuple(views), points, colors, "ARBITRARY" if scale is None else "METRIC", report)


def test_a_capture_becomes_metric() -> None:
    photos = _walk(np.random.default_rng(2), 40, 80.0, 4.0)
    places = [photo.place for photo in photos]
    capture = with_gps(_capture(photos), places)
    assert capture.scale == "METRIC" and capture.report.scale is not None and capture.report.scale.source == "gps"
    moved = capture.views[0].posed.world_from_camera[:3, 3] / photos[0].center
    np.testing.assert_allclose(moved, capture.report.scale.meters_per_unit)
    np.testing.assert_allclose(capture.points, capture.report.scale.meters_per_unit, rtol=1e-6)
    assert not {"place", "latitude"} & set(repr(capture.report).replace("_", " ").split()), "no place is stored"
    tilted = with_gps(_capture(photos, deviation_deg=15), places)
    assert tilted.scale == "ARBITRARY" and "which way is up" in tilted.report.warnings[0]
    none = _capture(photos)
    assert with_gps(none, [None] * 40) == none


def test_tags_and_places_are_combined() -> None:
    """In a scene that tags have made metric: the surer one leads, and both together are surer."""
    walk = _walk(np.random.default_rng(3), 40, 80.0, 4.0)
    photos = [replace(photo, center=photo.center * _METERS_PER_UNIT) for photo in walk]
    tags = ScaleEstimate("tags", 12.0, 0.01)
    capture = with_gps(_capture(photos, scale=tags), [photo.place for photo in photos])
    scale = capture.report.scale
    assert scale is not None and scale.source == "tags+gps" and scale.relative_error_95 < 0.015
    assert abs(scale.meters_per_unit / 12.0 - 1) < 0.01
    surer = combined_estimate(ScaleEstimate("tags", 1.0, 0.05), ScaleEstimate("gps", 1.02, 0.02))
    assert surer.source == "gps+tags" and 1.01 < surer.meters_per_unit < 1.02 and surer.relative_error_95 < 0.02


def test_a_second_estimate_is_of_the_world_that_the_first_has_scaled() -> None:
    photos = _walk(np.random.default_rng(3), 5, 80.0, 4.0)
    first, second = ScaleEstimate("sensor_depth", 4.0, 0.02), ScaleEstimate("tags", 1.01, 0.002)
    capture = metric_capture(metric_capture(_capture(photos), first), second)
    scale = capture.report.scale
    assert scale is not None and scale.source == "tags+sensor_depth" and 4.035 < scale.meters_per_unit < 4.0401
    np.testing.assert_allclose(capture.points, scale.meters_per_unit, rtol=1e-6)
    center = capture.views[2].posed.world_from_camera[:3, 3]
    np.testing.assert_allclose(center, scale.meters_per_unit * photos[2].center)


def test_contradicting_estimates_widen_the_interval_as_known_lengths_do() -> None:
    apart = combined_estimate(ScaleEstimate("tags", 1.0, 0.01), ScaleEstimate("gps", 1.2, 0.02))
    known = [ScaledLength(1.0, error / NORMAL_95, meters, 0.0) for error, meters in ((0.01, 1), (0.02, 1.2))]
    lengths = combined(known)
    assert apart.meters_per_unit == pytest.approx(lengths.meters_per_unit)
    assert apart.relative_error_95 == pytest.approx(NORMAL_95 * lengths.deviation)


_GPS = ExifTags.GPS


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {_GPS.GPSLatitude: (91.0, 0.0, 0.0)},
        {_GPS.GPSLatitude: (float("nan"), 0.0, 0.0)},
        {_GPS.GPSLatitude: "47 N"},
        {_GPS.GPSLatitude: (1.0, 2.0)},
        {_GPS.GPSLatitude: (-4.0, 0.0, 0.0)},
        {_GPS.GPSLatitudeRef: 7},
        {_GPS.GPSLatitude: (0.0, 0.0, 0.0), _GPS.GPSLongitude: (0.0, 0.0, 0.0)},
    ],
)
def test_places_that_cannot_be_are_none(tags: dict[int, object]) -> None:
    good = {
        _GPS.GPSLatitude: (47.0, 30.0, 36.0), _GPS.GPSLatitudeRef: "S", _GPS.GPSLongitude: (8.0, 0.0, 0.0),
        _GPS.GPSLongitudeRef: "W", _GPS.GPSHPositioningError: 4.5,
    }  # fmt: skip
    assert place_of_exif(good) == PhotoPlace(-47.51, -8.0, 4.5)
    assert place_of_exif({**good, **tags} if tags else {}) is None
    inexact = place_of_exif({**good, _GPS.GPSHPositioningError: -1})
    assert inexact is not None and inexact.accuracy_m is None
