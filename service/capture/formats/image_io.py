"""Checks and decodes images of uploads; writes images of captures."""

from __future__ import annotations

import importlib
import math
import struct
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, TiffImagePlugin, UnidentifiedImageError

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.photo_times import taken_at_of_exif
from fastsplat_contract.errors import CorruptImageError, InvalidInputError, LimitExceededError

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp", ".heic", ".heif"})
UNSUPPORTED_SUFFIXES = frozenset({".avif", ".dng", ".cr2", ".nef", ".arw", ".gif", ".exr"})
Image.init()  # registers all decoders; only these are ever tried:
IMAGE_FORMATS = ("JPEG", "PNG", "WEBP", "TIFF", "BMP")
_HEIF_MARK = b"ftyp"
_MIRRORED = frozenset({2, 4, 5, 7})
_TRANSPOSED = frozenset({5, 6, 7, 8})
_QUARTER_TURNS = {6: 1, 3: 2, 8: 3}  # EXIF orientation to clockwise rotations by 90° that make it upright
_MAX_EXPOSURE_EV = 40.0
_Number = TypeVar("_Number", np.uint8, np.uint16)


@dataclass(frozen=True)
class PhotoInfo:
    """Header of an image."""

    path: str  # in the upload, with forward slashes
    width: int  # as stored, before the orientation is applied
    height: int
    orientation: int  # EXIF orientation, 1..8; 1 is upright
    lens: str  # distinguishes cameras: maker, model and 35 mm focal length, as far as known
    focal_35mm: float  # millimeters on a 36×24 mm frame; 0 if unknown
    exposure_ev: float | None = None  # log2(seconds × ISO / 100 / f-number²), which includes any exposure bias
    taken_at: float | None = None  # seconds since 1970; None without a time zone
    transparent: bool = False  # some pixels are wholly transparent, as far as `check_image` has looked

    @property
    def upright_size(self) -> tuple[int, int]:
        """(width, height) after applying the orientation."""
        return (self.height, self.width) if self.orientation in _TRANSPOSED else (self.width, self.height)

    @property
    def focal_of_side(self) -> float | None:
        """Focal length over the longer side, from `focal_35mm` by the frame's diagonal; None if unknown."""
        if not self.focal_35mm:
            return None
        diagonal = math.hypot(self.width, self.height)
        return self.focal_35mm / math.hypot(36.0, 24.0) * diagonal / max(self.width, self.height)

    @property
    def mirrored(self) -> bool:
        """Checks if the orientation mirrors the image."""
        return self.orientation in _MIRRORED

    @property
    def quarter_turns(self) -> int:
        """Clockwise 90° rotations that make an unmirrored image upright."""
        return _QUARTER_TURNS.get(self.orientation, 0)


def check_image(root: Path, name: str, settings: CaptureSettings) -> PhotoInfo:
    """Reads an image's header after decoding all its bytes, coarsely if the format can.

    Raises:
        CorruptImageError: not an image of a supported format, cut short, or of unreadable colors.
        LimitExceededError: more pixels than `max_image_pixels`; checked in the header, before decoding.
    """
    with _open(root / name, name, settings) as image:
        # A PNG's EXIF may follow its pixels: asking for it would decode them and hide their errors.
        info = None if image.format == "PNG" else _info(image, name)
        image.draft("RGB", (max(1, image.width // 8), max(1, image.height // 8)))
        _decode(image, name)
        # One pixel shows if the colors are readable; of gray values beyond 8 bits, all are needed for their range.
        _rgb(image if image.mode.startswith("I") else image.crop((0, 0, 1, 1)), name)
        alpha = _alpha(image)
        return replace(info or _info(image, name), transparent=alpha is not None and not alpha.all())


def read_header(root: Path, name: str, settings: CaptureSettings) -> PhotoInfo:
    """Reads an image's header without decoding pixels. Raises as `check_image`."""
    with _open(root / name, name, settings) as image:
        return _info(image, name)


def read_size(root: Path, name: str, settings: CaptureSettings) -> tuple[int, int]:
    """Reads (width, height) as stored, without decoding. Raises as `check_image`."""
    with _open(root / name, name, settings) as image:
        return image.width, image.height


def load_upright(root: Path, info: PhotoInfo, settings: CaptureSettings) -> NDArray[np.uint8]:
    """Decodes upright uint8 [H, W, 3]: upper bytes of 16-bit values, transparency on black."""
    return apply_orientation(load_stored(root, info.path, settings), info.orientation)


def load_stored(root: Path, name: str, settings: CaptureSettings) -> NDArray[np.uint8]:
    """Decodes as `load_upright`, but without applying the orientation."""
    with _open(root / name, name, settings) as image:
        _decode(image, name)
        return _rgb(image, name)


def load_opaque(root: Path, info: PhotoInfo, settings: CaptureSettings) -> NDArray[np.uint8]:
    """Decodes an upright opacity mask, uint8 [H, W]: 0 if wholly transparent, else 255."""
    with _open(root / info.path, info.path, settings) as image:
        _decode(image, info.path)
        alpha = _alpha(image)
        opaque = np.ones(image.size[::-1], np.bool_) if alpha is None else alpha > 0
    return apply_orientation(np.where(opaque, np.uint8(255), np.uint8(0)), info.orientation)


def apply_orientation(pixels: NDArray[_Number], orientation: int) -> NDArray[_Number]:
    """Turns pixels upright by EXIF orientation (CIPA DC-008, 4.6.4 A)."""
    upright = {
        1: lambda p: p,
        2: lambda p: p[:, ::-1],
        3: lambda p: p[::-1, ::-1],
        4: lambda p: p[::-1],
        5: lambda p: p.swapaxes(0, 1),
        6: lambda p: np.rot90(p, -1),
        7: lambda p: p[::-1, ::-1].swapaxes(0, 1),
        8: lambda p: np.rot90(p, 1),
    }[orientation](pixels)
    return np.ascontiguousarray(upright)


def open_map(root: Path, name: str, settings: CaptureSettings, *, depth: bool = False) -> NDArray[np.uint16]:
    """Decodes a label map or mask, uint16 [H, W].

    One channel of 1, 8 or 16 bits, palette indices, or gray in three channels.

    Args:
        depth: for a depth map, 8 bits are too few.

    Raises:
        InvalidInputError: it has colors instead of ids, or too few bits.
        CorruptImageError, LimitExceededError: as `check_image`.
    """
    with _open(root / name, name, settings) as image:
        _decode(image, name)
        if depth and not image.mode.startswith("I"):
            raise InvalidInputError.of(
                name,
                "has 8 bits a channel: it is a picture of depth, not a depth map",
                "Save 16-bit gray PNG, in millimeters unless depth_unit_scale_factor says otherwise, or .npy.",
            )
        values = np.asarray(image)
        if image.mode in ("RGB", "RGBA") and (values[..., :3] == values[..., :1]).all():
            values = values[..., 0]
        elif image.mode not in ("1", "L", "P", "I", "I;16", "I;16B"):
            raise InvalidInputError.of(
                name,
                f"has colors ({image.mode}) where one label id per pixel is expected",
                "Save label maps as 8- or 16-bit gray PNG.",
            )
    if values.dtype == np.int32 and (values.min() < 0 or values.max() > 65535):
        raise InvalidInputError.of(name, "has label ids outside 0..65535", "Save it as 16-bit gray PNG.")
    return values.astype(np.uint16)


def save_rgb(pixels: NDArray[np.uint8], path: Path) -> None:
    """Writes uint8 [H, W, 3] as lossless PNG or high-quality JPEG, by the path's suffix."""
    image = Image.fromarray(pixels)
    if path.suffix == ".png":
        image.save(path, compress_level=1)
    else:
        image.save(path, quality=95, subsampling=0)


def load_rgb(path: Path) -> NDArray[np.uint8]:
    """Loads uint8 [H, W, 3] of an image that this service wrote."""
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def _open(path: Path, name: str, settings: CaptureSettings) -> Image.Image:
    try:
        with path.open("rb") as file:
            is_heif = file.read(8)[4:] == _HEIF_MARK
        if is_heif:
            _register_heif()
        image = Image.open(path, formats=("HEIF",) if is_heif else IMAGE_FORMATS)
    except Image.DecompressionBombError as error:
        raise too_many_pixels(name, "far too many", settings) from error
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError, TypeError, EOFError) as error:
        if _has_floats(path):
            raise _floats(name) from error
        raise CorruptImageError.of(
            name,
            "is not an image this service can read",
            "Remove it, or save it again as JPEG, PNG, WebP, TIFF, BMP or HEIC.",
        ) from error
    if image.width * image.height > settings.max_image_pixels:
        image.close()
        raise too_many_pixels(name, f"{image.width}×{image.height}", settings)
    return image


@cache
def _register_heif() -> None:
    """Lets Pillow read HEIC; loaded on first use, in the sandbox.

    libheif rotates the pixels and the plugin resets EXIF's orientation, so neither is applied twice.
    """
    pi_heif = importlib.import_module("pi_heif")
    pi_heif.register_heif_opener(thumbnails=False, depth_images=False, aux_images=False, decode_threads=1)


def too_many_pixels(name: str, size: str, settings: CaptureSettings) -> LimitExceededError:
    """Makes the error of an image with too many pixels."""
    return LimitExceededError.of(
        name,
        f"has {size} pixels",
        "Send a smaller version.",
        f"{settings.max_image_pixels} pixels an image (FASTSPLAT_CAPTURE__MAX_IMAGE_PIXELS)",
    )


def _decode(image: Image.Image, name: str) -> None:
    size = image.size
    try:
        image.load()
        if image.size != size:
            raise ValueError(f"its header says {size[0]}×{size[1]} pixels, its content {image.width}×{image.height}")
    except (
        RuntimeError,  # libheif's
        OSError,
        ValueError,
        SyntaxError,
        EOFError,
        IndexError,
        Image.DecompressionBombError,
    ) as error:
        raise CorruptImageError.of(
            name, f"is cut short or damaged: {error}", "Copy it again from the camera, or remove it."
        ) from error


def _info(image: Image.Image, name: str) -> PhotoInfo:
    try:
        exif = image.getexif()
        detail = exif.get_ifd(ExifTags.IFD.Exif)
        orientation = exif.get(ExifTags.Base.Orientation, 1)
        focal = float(detail.get(ExifTags.Base.FocalLengthIn35mmFilm, 0) or 0)
        exposure_ev, taken_at = _exposure_ev(detail), taken_at_of_exif(detail, exif.get_ifd(ExifTags.IFD.GPSInfo))
        maker = [str(exif.get(tag, "")).strip("\0 ") for tag in (ExifTags.Base.Make, ExifTags.Base.Model)]
    except Exception:  # mangled EXIF does not affect the pixels, and Pillow raises a dozen types for it
        orientation, focal, maker, exposure_ev, taken_at = 1, 0.0, ["", ""], None, None
    if orientation not in range(1, 9):
        orientation = 1
    if not 5.0 <= focal <= 2_000.0:
        focal = 0.0
    lens = "/".join([*maker, f"{focal:g}"])
    return PhotoInfo(name, image.width, image.height, int(orientation), lens, focal, exposure_ev, taken_at)


def _has_floats(path: Path) -> bool:
    """Detects a TIFF of floating-point numbers by its first directory."""
    with suppress(SyntaxError, OSError, ValueError, struct.error, KeyError, EOFError), path.open("rb") as file:
        tags = TiffImagePlugin.ImageFileDirectory_v2(file.read(8))
        file.seek(tags.next)
        tags.load(file)
        return 3 in np.atleast_1d(tags.get(TiffImagePlugin.SAMPLEFORMAT, 1))
    return False


def _floats(name: str) -> CorruptImageError:
    return CorruptImageError.of(
        name, "has floating-point pixels, whose brightness nothing says", "Save it as 8-bit RGB."
    )


def _alpha(image: Image.Image) -> NDArray[np.uint8] | None:
    """Alpha channel of a decoded image, uint8 [H, W]; None where its format has none."""
    if image.mode not in ("RGBA", "LA", "PA", "RGBa", "La") and "transparency" not in image.info:
        return None
    return np.asarray(image.convert("RGBA").getchannel("A"))


def _exposure_ev(detail: Mapping[int, Any]) -> float | None:
    """Computes `PhotoInfo.exposure_ev` from the Exif IFD (CIPA DC-008, 4.6.5)."""
    speed = detail.get(ExifTags.Base.ISOSpeedRatings)
    speed = speed[0] if isinstance(speed, tuple) and speed else speed
    exposure: list[Any] = [detail.get(ExifTags.Base.ExposureTime), speed, detail.get(ExifTags.Base.FNumber)]
    if any(value is None for value in exposure):
        return None
    seconds, iso, f_number = (float(value) for value in exposure)
    if not (seconds > 0 and iso > 0 and f_number > 0):
        return None
    exposure_ev = math.log2(seconds * iso / 100 / f_number**2)
    return exposure_ev if abs(exposure_ev) <= _MAX_EXPOSURE_EV else None


def _rgb(image: Image.Image, name: str) -> NDArray[np.uint8]:
    if image.mode == "F":
        raise _floats(name)
    if image.mode in ("I;16", "I;16B", "I;16L", "I"):
        wide = np.asarray(image).astype(np.int64)
        if wide.min() < 0 or wide.max() > 65535:
            raise CorruptImageError(f"{name} has gray values outside 0..65535", field=name, hint="Save it as 8 bits.")
        gray = (wide >> 8).astype(np.uint8)
        return np.repeat(gray[..., None], 3, axis=2)
    if _alpha(image) is not None:
        rgba = image.convert("RGBA")
        black = Image.new("RGBA", rgba.size, (0, 0, 0, 255))
        return np.asarray(Image.alpha_composite(black, rgba).convert("RGB"))
    try:
        return np.asarray(image.convert("RGB"))
    except ValueError as error:
        raise CorruptImageError.of(
            name, f"has a color mode {image.mode} that cannot be read", "Save it as 8-bit RGB."
        ) from error
