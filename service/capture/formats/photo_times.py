"""Reads capture times from EXIF. Untrusted: implausible values count as absent."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from typing import Any

from PIL import ExifTags

_FORMAT = "%Y:%m:%d %H:%M:%S %z"
_EARLIEST = datetime(1990, 1, 1, tzinfo=UTC).timestamp()
_LATEST = datetime(2200, 1, 1, tzinfo=UTC).timestamp()
_MOST_OFFSET = timedelta(hours=14)


def taken_at_of_exif(detail: Mapping[int, Any], gps: Mapping[int, Any]) -> float | None:
    """Reads a photo's UTC time in seconds since 1970; None without a time zone.

    From DateTimeOriginal with OffsetTimeOriginal and SubSecTimeOriginal, else from the GPS block (its last fix).

    Args:
        detail: tags of the Exif IFD (CIPA DC-008-2019, 4.6.5 D and F).
        gps: tags of the GPS IFD (4.6.6).
    """
    zone = detail.get(ExifTags.Base.OffsetTimeOriginal) or detail.get(ExifTags.Base.OffsetTime)
    seconds = _seconds(detail.get(ExifTags.Base.DateTimeOriginal), zone)
    if seconds is not None:
        seconds += _fraction(detail.get(ExifTags.Base.SubsecTimeOriginal))
    else:
        seconds = _gps_seconds(gps)
    return seconds if seconds is not None and _EARLIEST <= seconds < _LATEST else None


def _seconds(text: Any, zone: Any) -> float | None:
    """Parses a time in a zone as "+02:00", "-07:30" or "Z"."""
    stated, zone = (str(part or "").strip("\0 ") for part in (text, zone))
    try:
        time = datetime.strptime(f"{stated} {zone}", _FORMAT)
        return time.timestamp() if abs(time.utcoffset() or timedelta(0)) <= _MOST_OFFSET else None
    except (ValueError, OverflowError):
        return None


def _fraction(text: Any) -> float:
    digits = str(text or "").strip("\0 ")
    return float(f"0.{digits}") if digits.isascii() and digits.isdigit() and len(digits) <= 9 else 0.0


def _gps_seconds(gps: Mapping[int, Any]) -> float | None:
    date, clock = gps.get(ExifTags.GPS.GPSDateStamp), gps.get(ExifTags.GPS.GPSTimeStamp)
    if not isinstance(clock, tuple) or len(clock) != 3:
        return None
    try:
        hours, minutes, seconds = (float(part) for part in clock)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    if not (0 <= hours < 24 and 0 <= minutes < 60 and 0 <= seconds < 61):  # also false for NaN
        return None
    midnight = _seconds(f"{str(date).strip(chr(0) + ' ')} 00:00:00", "Z")
    total = 3600 * hours + 60 * minutes + seconds
    return None if midnight is None or not math.isfinite(total) else midnight + total
