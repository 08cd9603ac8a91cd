"""When photos were taken, as their EXIF says, and nothing where it does not."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import ExifTags, Image

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.image_io import check_image
from fastsplat.service.capture.formats.photo_times import taken_at_of_exif
from fastsplat.service.capture.untrusted.image_decoder import ImageDecoder

_BASE, _GPS = ExifTags.Base, ExifTags.GPS
_TIME = datetime(2026, 3, 4, 12, 30, 15, tzinfo=UTC).timestamp()


def _detail(time: Any = "2026:03:04 12:30:15", offset: Any = None, fraction: Any = None) -> dict[int, Any]:
    tags = {_BASE.DateTimeOriginal: time, _BASE.OffsetTimeOriginal: offset, _BASE.SubsecTimeOriginal: fraction}
    return {tag: value for tag, value in tags.items() if value is not None}


@pytest.mark.parametrize(
    ("detail", "expected"),
    [
        (_detail(), None),  # in which time zone?
        (_detail(offset="Z"), _TIME),
        (_detail(offset="+00:00", fraction="25"), _TIME + 0.25),
        (_detail(offset="+05:30\0"), _TIME - 5.5 * 3600),
        (_detail(offset="-08:00"), _TIME + 8 * 3600),
        (_detail(offset="+15:00"), None),
        (_detail(offset="+01:75"), None),
        (_detail(offset="hours"), None),
        (_detail("0000:00:00 00:00:00", offset="Z"), None),
        (_detail("1970:01:01 00:00:00", offset="Z"), None),  # a clock that nobody set
        (_detail(b"\xff", offset="Z"), None),
    ],
)
def test_a_time_needs_its_zone(detail: dict[int, Any], expected: float | None) -> None:
    assert taken_at_of_exif(detail, {}) == (None if expected is None else pytest.approx(expected))


def test_the_time_of_the_last_fix_stands_in() -> None:
    gps = {_GPS.GPSDateStamp: "2026:03:04", _GPS.GPSTimeStamp: (12.0, 30.0, 15.0)}
    assert taken_at_of_exif(_detail(), gps) == pytest.approx(_TIME)
    assert taken_at_of_exif(_detail("2026:03:04 13:30:17", "+01:00"), gps) == pytest.approx(_TIME + 2)
    assert taken_at_of_exif({}, {**gps, _GPS.GPSTimeStamp: (25.0, 0.0, 0.0)}) is None
    assert taken_at_of_exif({}, {_GPS.GPSTimeStamp: (12.0, 30.0, 15.0)}) is None


_ANYTHING = (
    st.none() | st.text(max_size=20) | st.binary(max_size=20) | st.floats() | st.tuples(st.floats(), st.floats())
)


@given(_ANYTHING, _ANYTHING, _ANYTHING, _ANYTHING, _ANYTHING | st.tuples(st.floats(), st.floats(), st.floats()))
def test_whatever_stands_there_is_a_time_or_nothing(time: Any, offset: Any, part: Any, date: Any, clock: Any) -> None:
    seconds = taken_at_of_exif(_detail(time, offset, part), {_GPS.GPSDateStamp: date, _GPS.GPSTimeStamp: clock})
    assert seconds is None or 6e8 < seconds < 7.3e9


def test_a_photo_says_when_it_was_taken(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif).update(_detail(offset="+01:00"))
    Image.new("RGB", (64, 48)).save(tmp_path / "a.jpg", exif=exif)
    Image.new("RGB", (64, 48)).save(tmp_path / "b.jpg")
    folder = tmp_path / "decoder"
    folder.mkdir()
    with ImageDecoder(folder, (tmp_path,), CaptureSettings()) as decoder:
        for read in (partial(check_image, settings=CaptureSettings()), decoder.header):
            assert read(tmp_path, "a.jpg").taken_at == pytest.approx(_TIME - 3600)
            assert read(tmp_path, "b.jpg").taken_at is None
