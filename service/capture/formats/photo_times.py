"""Reads capture times from EXIF. Untrusted: implausible values count as absent."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from typing import Any

from PIL import ExifTags

_FORMAT = "%Y:%m:%d %H:%M:%S"
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
    offset = _offset(detail.get(ExifTags.Base.OffsetTimeOriginal) or detail.get(ExifTags.Base.OffsetTime))
    seconds = None
    if offset is not None:
        seconds = _seconds(detail.get(ExifTags.Base.DateTimeOriginal), offset)
        if seconds is not None:
            seconds += _fraction(detail.get(ExifTags.Base.SubsecTimeOriginal))
    if seconds is None:
        seconds = _gps_seconds(gps)
    return seconds if seconds is not None and _EARLIEST <= seconds < _LATEST else None


def _seconds(text: Any, offset: timedelta) -> float | None:
    try:
        return (datetime.strptime(str(text).strip("\0 "), _FORMAT).replace(tzinfo=UTC) - offset).timestamp()
    except (ValueError, OverflowError):
        return None


def _offset(text: Any) -> timedelta | None:
    """Parses "+02:00", "-07:30" or "Z"."""
    text = str(text or "").strip("\0 ")
    if text == "Z":
        return timedelta(0)
    sign, hours, colon, minutes = text[:1], text[1:3], text[3:4], text[4:]
    digits = f"{hours}{minutes}"
    if sign not in ("+", "-") or colon != ":" or len(digits) != 4 or not (digits.isascii() and digits.isdigit()):
        return None
    offset = timedelta(hours=int(hours), minutes=int(minutes))
    if offset > _MOST_OFFSET or int(minutes) > 59:
        return None
    return -offset if sign == "-" else offset


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
    midnight = _seconds(f"{str(date).strip(chr(0) + ' ')} 00:00:00", timedelta(0))
    total = 3600 * hours + 60 * minutes + seconds
    return None if midnight is None or not math.isfinite(total) else midnight + total
