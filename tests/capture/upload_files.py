"""Files that uploads consist of, and the capture of an upload."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import Capture, View
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent

PINHOLE = {"w": 64, "h": 48, "fl_x": 60.0, "fl_y": 60.0, "cx": 32.0, "cy": 24.0}
"""The camera of a `transforms.json` for photos of `photo_file`."""


def encoded(picture: np.ndarray | Image.Image, form: str = "PNG", **options: Any) -> bytes:
    stream = io.BytesIO()
    image = picture if isinstance(picture, Image.Image) else Image.fromarray(picture)
    image.save(stream, form, **options)
    return stream.getvalue()


def photo_file(seed: int = 0, size: tuple[int, int] = (64, 48), form: str = "JPEG", **options: Any) -> bytes:
    """An encoded image with texture; the seed makes it unlike others."""
    coarse = np.random.default_rng(seed).integers(0, 256, (size[1] // 4, size[0] // 4, 3), dtype=np.uint8)
    return encoded(np.asarray(Image.fromarray(coarse).resize(size)), form, **options)


def turned(orientation: int) -> Image.Exif:
    """EXIF of a photo that is stored in this orientation."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    return exif


def points_file(*points: tuple[float, float, float]) -> bytes:
    """A PLY in ASCII."""
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n" + "".join(f"property float {x}\n" for x in "xyz")
    return (head + "end_header\n" + "".join(f"{x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in points)).encode()


def frames_of(names: Iterable[str], pose: np.ndarray | None = None) -> list[dict[str, Any]]:
    """Frames of a `transforms.json`, all of one pose."""
    matrix = (np.eye(4) if pose is None else pose).tolist()
    return [{"file_path": name, "transform_matrix": matrix} for name in names]


def video_file(path: Path, frames: Sequence[np.ndarray], code: str = "MJPG") -> bytes:
    """Writes a video of RGB frames, ten a second."""
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), 10, (width, height))
    for frame in frames:
        writer.write(np.ascontiguousarray(frame[..., ::-1]))
    writer.release()
    return path.read_bytes()


def captured(folder: Path, settings: CaptureSettings) -> Capture:
    """The capture of an upload, in the folder `out` beside it."""
    validate_upload(folder, settings)
    return build_capture(folder, folder.parent / "out", settings, silent)


def valid_pixels(view: View) -> np.ndarray:
    """bool [H, W]: which pixels of a view count."""
    if view.valid_path is None:
        return np.ones((view.posed.camera.height, view.posed.camera.width), bool)
    return np.asarray(Image.open(view.valid_path)) > 0
