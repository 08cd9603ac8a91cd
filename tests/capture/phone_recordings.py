"""Recordings of phones as their apps export them, made from photos with known OpenCV poses in a world with z up."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import lzfse
import numpy as np

from fastsplat_contract.geometry.poses import quaternion_of
from tests.capture.upload_files import encoded

_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0], [0, 0, 0, 1.0]])


@dataclass(frozen=True)
class Frame:
    """One frame: an encoded JPEG of `size`, (fx, fy, cx, cy), world-from-camera; depth in meters and ARKit's levels."""

    jpeg: bytes
    size: tuple[int, int]
    intrinsics: tuple[float, float, float, float]
    pose: np.ndarray
    depth: np.ndarray
    confidence: np.ndarray

    @property
    def arkit(self) -> np.ndarray:
        """[4, 4] as ARKit has it: y up, camera axes of OpenGL."""
        return np.asarray(_Y_UP @ self.pose @ _OPENGL)


def _millimeters(depth: np.ndarray) -> bytes:
    return encoded(np.nan_to_num(depth * 1000).round().astype(np.uint16))


def polycam(frames: list[Frame], corrected: bool = True) -> dict[str, bytes]:
    cameras, images = ("corrected_cameras", "corrected_images") if corrected else ("cameras", "images")
    files = {"mesh_info.json": b'{"alignmentTransform": []}'}
    for index, frame in enumerate(frames):
        stem = f"{1000 + index}"
        document = {f"t_{row}{column}": frame.arkit[row, column] for row in range(3) for column in range(4)}
        document |= dict(zip(("fx", "fy", "cx", "cy"), frame.intrinsics, strict=True))
        document |= {"width": frame.size[0], "height": frame.size[1], "blur_score": 90.0, "timestamp": index}
        files[f"keyframes/{cameras}/{stem}.json"] = json.dumps(document).encode()
        files[f"keyframes/{images}/{stem}.jpg"] = frame.jpeg
        files[f"keyframes/depth/{stem}.png"] = _millimeters(frame.depth)
        files[f"keyframes/confidence/{stem}.png"] = encoded((frame.confidence * 127).astype(np.uint8))
    return files


def record3d_files(frames: list[Frame], **changes: Any) -> dict[str, bytes]:
    """What is in an .r3d."""
    fx, fy, cx, cy = frames[0].intrinsics
    height, width = frames[0].depth.shape
    document: dict[str, Any] = {"w": frames[0].size[0], "h": frames[0].size[1], "dw": width, "dh": height, "fps": 30}
    document |= {"K": [fx, 0, 0, 0, fy, 0, cx, cy, 1], "poses": [_quaternion(frame.arkit) for frame in frames]}
    files = {"metadata": json.dumps(document | changes).encode(), "icon": b"no image", "sound.m4a": b"no sound"}
    for index, frame in enumerate(frames):
        files[f"rgbd/{index}.jpg"] = frame.jpeg
        files[f"rgbd/{index}.depth"] = lzfse.compress(frame.depth.astype("<f4").tobytes())
        files[f"rgbd/{index}.conf"] = lzfse.compress(frame.confidence.astype(np.uint8).tobytes())
    return files


def scanner_app(frames: list[Frame]) -> dict[str, bytes]:
    """Files of 3D Scanner App; between two photos there is a frame without one."""
    files = {}
    for index, frame in enumerate(frames):
        fx, fy, cx, cy = frame.intrinsics
        document = {"cameraPoseARFrame": frame.arkit.ravel().tolist(), "intrinsics": [fx, 0, cx, 0, fy, cy, 0, 0, 1]}
        for number in (2 * index, 2 * index + 1):
            files[f"scan/frame_{number:05d}.json"] = json.dumps(document | {"frame_index": number}).encode()
            files[f"scan/depth_{number:05d}.png"] = _millimeters(frame.depth)
            files[f"scan/conf_{number:05d}.png"] = encoded(frame.confidence.astype(np.uint8))
        files[f"scan/frame_{2 * index:05d}.jpg"] = frame.jpeg
    return files


def _quaternion(matrix: np.ndarray) -> list[float]:
    """[qx, qy, qz, qw, tx, ty, tz]."""
    return [*quaternion_of(matrix[:3, :3]), *matrix[:3, 3].tolist()]
