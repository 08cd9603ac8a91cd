"""Reads panorama, place and gravity from photo metadata. For the confined child.

Untrusted: numbers are bounded, and implausible values count as absent.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from PIL import ExifTags, Image

from fastsplat.service.capture.formats.image_io import IMAGE_FORMATS, PhotoInfo
from fastsplat.service.capture.photos.panorama import PanoramaFrame, frame_of_xmp

_APPLE = b"Apple iOS\0\0\x01MM"
_ACCELERATION = 8
_SIGNED_RATIONAL = 10
_MOST_ENTRIES = 64
_GRAVITY_RANGE = (0.8, 1.25)  # g; outside, the phone was shaken


@dataclass(frozen=True)
class PhotoPlace:
    """Capture place of a photo by its EXIF, WGS84."""

    latitude_deg: float
    longitude_deg: float
    accuracy_m: float | None  # radius stated by the device (GPSHPositioningError)


@dataclass(frozen=True)
class PhotoMetadata:
    """Metadata of a photo."""

    frame: PanoramaFrame | None = None
    place: PhotoPlace | None = None
    up: tuple[float, float, float] | None = None  # unit vector in the upright photo's frame (OpenCV axes)


def read_metadata(root: Path, photos: Sequence[PhotoInfo]) -> dict[str, dict[str, Any]]:
    """Reads metadata of checked photos by path, JSON-ready; photos without any are omitted."""
    metadata = {photo.path: _read(root, photo) for photo in photos}
    return {path: asdict(entry) for path, entry in metadata.items() if entry != PhotoMetadata()}


def _read(root: Path, photo: PhotoInfo) -> PhotoMetadata:
    try:
        with Image.open(root / photo.path, formats=IMAGE_FORMATS) as image:
            xmp = image.info.get("xmp", b"")
            exif = image.getexif()
            gps, detail = exif.get_ifd(ExifTags.IFD.GPSInfo), exif.get_ifd(ExifTags.IFD.Exif)
    except Exception:  # mangled metadata count as absent, and Pillow raises a dozen types for them
        return PhotoMetadata()
    frame = frame_of_xmp(xmp, photo.width, photo.height) if isinstance(xmp, bytes) and photo.orientation == 1 else None
    return PhotoMetadata(frame, place_of_exif(gps), up_of_exif(detail, photo))


def place_of_exif(gps: Mapping[int, Any]) -> PhotoPlace | None:
    """Reads the place of an EXIF GPS IFD (CIPA DC-008, 4.6.6), if valid."""
    latitude = _degrees(gps.get(ExifTags.GPS.GPSLatitude), gps.get(ExifTags.GPS.GPSLatitudeRef), "S", 90.0)
    longitude = _degrees(gps.get(ExifTags.GPS.GPSLongitude), gps.get(ExifTags.GPS.GPSLongitudeRef), "W", 180.0)
    if latitude is None or longitude is None or (latitude == 0 and longitude == 0):
        return None
    accuracy = _finite(gps.get(ExifTags.GPS.GPSHPositioningError), 1e5)
    return PhotoPlace(latitude, longitude, accuracy if accuracy is not None and accuracy > 0 else None)


def up_of_exif(detail: Mapping[int, Any], photo: PhotoInfo) -> tuple[float, float, float] | None:
    """Reads the unit vector up in the upright photo's frame from an iPhone's acceleration.

    Maker note tag 8, three rationals in g (https://exiftool.org/TagNames/Apple.html): to the left of the phone, to its
    bottom and into its face, seen from the front, in portrait. At rest, a phone is accelerated upwards. None for the
    front camera, which looks the other way.
    """
    note, lens = detail.get(ExifTags.Base.MakerNote), str(detail.get(ExifTags.Base.LensModel, ""))
    if not isinstance(note, bytes) or "front" in lens.casefold() or photo.mirrored:
        return None
    values = _apple_acceleration(note)
    if values is None:
        return None
    length = math.sqrt(sum(value * value for value in values))
    if not _GRAVITY_RANGE[0] <= length <= _GRAVITY_RANGE[1]:
        return None
    left, bottom, face = (value / length for value in values)
    x, y = -left, bottom  # of the photo in portrait; its stored pixels are turned back by a quarter
    x, y = y, -x
    for _ in range(photo.quarter_turns):
        x, y = -y, x
    return x, y, face


def _apple_acceleration(note: bytes) -> tuple[float, float, float] | None:
    if not note.startswith(_APPLE) or len(note) < len(_APPLE) + 2:
        return None
    (count,) = struct.unpack_from(">H", note, len(_APPLE))
    for entry in range(min(count, _MOST_ENTRIES)):
        at = len(_APPLE) + 2 + 12 * entry
        if at + 12 > len(note):
            return None
        tag, kind, number, offset = struct.unpack_from(">HHII", note, at)
        if tag == _ACCELERATION:
            if kind != _SIGNED_RATIONAL or number != 3 or offset + 24 > len(note):
                return None
            parts = struct.unpack_from(">6i", note, offset)
            if 0 in parts[1::2]:
                return None
            return parts[0] / parts[1], parts[2] / parts[3], parts[4] / parts[5]
    return None


def _degrees(parts: Any, reference: Any, negative: str, most: float) -> float | None:
    if not isinstance(parts, tuple) or len(parts) != 3 or not isinstance(reference, str):
        return None
    numbers = [_finite(part, 360.0) for part in parts]
    if any(number is None or number < 0 for number in numbers):
        return None
    degrees, minutes, seconds = (number or 0.0 for number in numbers)
    value = degrees + minutes / 60 + seconds / 3600
    return None if value > most else -value if reference.strip("\0 ").upper() == negative else value


def _finite(value: Any, most: float) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if math.isfinite(number) and abs(number) <= most else None
