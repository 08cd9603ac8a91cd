"""360° panoramas: extent on the sphere and pinhole faces."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.photos.camera_model import Undistortion
from fastsplat.service.capture.photos.lens_faces import FACES, LensFace, face_camera, face_rays
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera

F64 = NDArray[np.float64]

_MAX_XMP_BYTES = 1 << 17
_MAX_SIDE = 1 << 20
_LEAST_SIDE = 64
_RATIO_TOLERANCE = 0.01
_FULL_WIDTH = 0.999


@dataclass(frozen=True)
class PanoramaFrame:
    """Extent of an equirectangular picture, in pixels of the full 360° × 180° picture.

    Raises:
        InvalidInputError: impossible numbers.
    """

    width: int  # of the full picture, twice its height
    height: int
    left: int  # of the stored picture in the full one
    top: int
    stored_width: int
    stored_height: int
    pitch_deg: float | None = None  # of the picture's center, by its metadata (GPano)
    roll_deg: float | None = None

    def __post_init__(self) -> None:
        sides = (self.width, self.height, self.stored_width, self.stored_height)
        if not (
            all(_LEAST_SIDE <= side <= _MAX_SIDE for side in sides)
            and abs(self.width - 2 * self.height) <= _RATIO_TOLERANCE * self.width
            and 0 <= self.left <= self.width + 1 - self.stored_width
            and 0 <= self.top <= self.height + 1 - self.stored_height
            and abs(self.pitch_deg or 0.0) <= 90
            and abs(self.roll_deg or 0.0) <= 180
        ):
            raise InvalidInputError("no panorama lies so on the sphere", field="panorama", hint="Check its metadata.")

    @property
    def around(self) -> bool:
        """Checks if the left and right edges meet."""
        return self.stored_width >= _FULL_WIDTH * self.width

    @property
    def vertical(self) -> F64 | None:
        """Unit vector up in the picture's frame (OpenCV axes, z to its center), or None.

        As in Photo Sphere XMP: rotated by heading, pitch (positive looks up), then roll (positive turns clockwise).
        """
        if self.pitch_deg is None or self.roll_deg is None:
            return None
        pitch, roll = math.radians(self.pitch_deg), math.radians(self.roll_deg)
        level = np.array([0.0, -math.cos(pitch), math.sin(pitch)])
        cosine, sine = math.cos(roll), math.sin(roll)
        turned = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(turned @ level)


def full_frame(name: str, width: int, height: int) -> PanoramaFrame:
    """Makes the frame of a picture of the whole sphere.

    Raises:
        InvalidInputError: it is not twice as wide as high.
    """
    if min(width, height) < _LEAST_SIDE or abs(width - 2 * height) > _RATIO_TOLERANCE * width:
        raise InvalidInputError.of(
            name,
            f"has {width}×{height} pixels, a 360° panorama is twice as wide as high",
            "Export the photos or the video as equirectangular 360° × 180°, for one eye, or leave the lens away.",
            "an aspect of 2:1",
        )
    return PanoramaFrame(width, height, 0, 0, width, height)


def frame_of_xmp(xmp: bytes, width: int, height: int) -> PanoramaFrame | None:
    """Reads the frame from XMP (https://developers.google.com/streetview/spherical-metadata); None without a valid one.

    Args:
        xmp: the packet; at most 128 KiB are read, and it is not parsed as XML.
        width, height: of the stored picture.
    """
    text = xmp[:_MAX_XMP_BYTES].decode("utf-8", "replace")
    if metadata_value(text, "GPano:ProjectionType") != "equirectangular":
        return None
    names = ("FullPanoWidthPixels", "FullPanoHeightPixels", "CroppedAreaLeftPixels", "CroppedAreaTopPixels")
    cropped = _number(text, "CroppedAreaImageWidthPixels")
    stated = [number for name in names if (number := _number(text, name)) is not None]
    pitch, roll = _number(text, "PosePitchDegrees"), _number(text, "PoseRollDegrees")
    whole = not any(metadata_value(text, f"GPano:{name}") for name in names)
    if not whole and len(stated) < len(names):
        return None
    full_width, full_height, left, top = (width, height, 0.0, 0.0) if whole else stated
    # Editors that resize a picture keep its old numbers.
    scale = width / cropped if cropped and not whole else 1.0
    full_width, full_height, left, top = (round(number * scale) for number in (full_width, full_height, left, top))
    try:
        return PanoramaFrame(full_width, full_height, left, top, width, height, pitch, roll)
    except InvalidInputError:
        return None


def panorama_faces(frame: PanoramaFrame, size: tuple[int, int], side: int) -> Iterator[LensFace]:
    """Makes the six faces of a panorama, without those wholly outside a partial one.

    Their undistortions are for pixels from `wrapped`.

    Args:
        size: (width, height) to which the stored picture was reduced.
        side: of a face, pixels.
    """
    camera = face_camera(side)
    rays = face_rays(camera)
    scale = np.array([size[0] / frame.stored_width, size[1] / frame.stored_height])
    for name, rotation in FACES.items():
        x, y, z = np.moveaxis(rays @ rotation.T, -1, 0)
        u = (np.arctan2(x, z) / (2 * np.pi) + 0.5) * frame.width - frame.left
        v = (np.arctan2(y, np.hypot(x, z)) / np.pi + 0.5) * frame.height - frame.top
        if frame.around:
            u %= frame.width
        map_xy = np.stack([u * scale[0], v * scale[1]], axis=-1) + 0.5  # - 0.5 for OpenCV, + 1 for the border
        if not frame.around:
            map_xy[(u < 0) | (u > frame.stored_width) | (v < 0) | (v > frame.stored_height)] = -1e6
        elif frame.stored_height < frame.height:
            map_xy[(v < 0) | (v > frame.stored_height)] = -1e6
        if (map_xy[..., 0] > -1e5).any():
            yield LensFace(name, rotation, Undistortion(camera, map_xy.astype(np.float32)))


def shown_by_any(masks: Mapping[str, NDArray[np.bool_]]) -> dict[str, NDArray[np.bool_]]:
    """Extends each face's mask, [S, S], by the masks of overlapping faces."""
    whole = {face: mask.copy() for face, mask in masks.items()}
    for source, mask in masks.items():
        if not mask.any():
            continue
        camera = face_camera(len(mask))
        rays = face_rays(camera).reshape(-1, 3)
        for face, union in whole.items():
            pose = np.eye(4)
            pose[:3, :3] = FACES[face].T @ FACES[source]
            inside, pixels, _ = PosedCamera(camera, pose).in_picture(rays)
            columns, rows = pixels.astype(np.int64).T
            union.reshape(-1)[inside] |= mask[rows, columns]
    return whole


def wrapped(pixels: NDArray[np.uint8] | NDArray[np.uint16], frame: PanoramaFrame) -> NDArray[np.uint8]:
    """Adds a border of one pixel to [H, W, ...], wrapped around where the panorama is."""
    beside: Literal["wrap", "edge"] = "wrap" if frame.around else "edge"
    rest = [(0, 0)] * (pixels.ndim - 2)
    tall = np.pad(pixels, [(1, 1), (0, 0), *rest], mode="edge")
    return np.asarray(np.pad(tall, [(0, 0), (1, 1), *rest], mode=beside))


def decoded_size(frame: PanoramaFrame, side: int) -> tuple[int, int]:
    """Decoding size (width, height) as sharp as faces of `side` pixels, which bounds memory."""
    scale = min(1.0, 2 * math.pi * face_camera(side).fx / frame.width)
    return max(1, round(frame.stored_width * scale)), max(1, round(frame.stored_height * scale))


def face_side(frame: PanoramaFrame, most: int) -> int:
    """Side of a face as sharp as the picture; even, from 32 to `most` pixels."""
    native = frame.width / (2 * math.pi) * 2 * math.tan(math.radians(48.0))
    return max(32, int(min(native, most)) // 2 * 2)


def nadir_mask(camera_side: int, face: str, nadir_deg: float) -> NDArray[np.bool_] | None:
    """Masks the nadir, where the photographer stands, false within `nadir_deg`; None if not visible."""
    rays = face_rays(face_camera(camera_side)) @ FACES[face].T
    mask = rays[..., 1] < math.cos(math.radians(nadir_deg)) * np.linalg.norm(rays, axis=-1)
    return None if nadir_deg <= 0 or mask.all() else np.asarray(mask)


def metadata_value(text: str, name: str) -> str:
    """Searches XMP for a property such as "GPano:ProjectionType", as attribute or element; "" if absent."""
    match = re.search(rf'{name}\s{{0,8}}(?:=\s{{0,8}}["\']|>)\s{{0,8}}([^"\'<]{{1,40}})', text)
    return match.group(1).strip() if match else ""


def _number(text: str, name: str) -> float | None:
    try:
        value = float(metadata_value(text, f"GPano:{name}"))
    except ValueError:
        return None
    return value if math.isfinite(value) and abs(value) <= _MAX_SIDE else None
