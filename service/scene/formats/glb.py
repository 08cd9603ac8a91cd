"""glTF 2.0 binary files (one JSON chunk, one buffer), and meshes in them."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.scene.artefact.scene import F32
from fastsplat_contract.errors import LimitExceededError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import quaternion_of

_HEADER = struct.Struct("<4sII")
_CHUNK = struct.Struct("<I4s")
_COMPONENTS = {"<f4": 5126, "|u1": 5121, "<u2": 5123, "<u4": 5125}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
LARGEST = (1 << 32) - 1
"""Maximum file size in bytes: the format has 32-bit sizes."""

_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])
_NEAREST = 0.01


@dataclass(frozen=True)
class NamedRows:
    """A node of a file."""

    name: str
    extras: dict[str, Any]  # metadata for programs, JSON-ready
    rows: NDArray[np.int64]  # [K], K ≥ 1: Gaussians, vertices or faces


@dataclass(frozen=True)
class GlbScene:
    """Scene metadata of a file."""

    name: str
    extras: dict[str, Any]  # JSON-ready
    up: NDArray[np.float64] | None  # [3], unit vector in the world frame that the root turns to +y; None if unknown
    cameras: Sequence[PosedCamera]


class GlbBuilder:
    """Collects a glTF document and its buffer; `file` adds accessors, bufferViews and buffers."""

    def __init__(self, generator: str) -> None:
        self.document: dict[str, Any] = {"asset": {"version": "2.0", "generator": generator}}
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._data: list[bytes] = []
        self._size = 0

    def add(self, kind: str, entry: dict[str, Any]) -> int:
        entries: list[dict[str, Any]] = self.document.setdefault(kind, [])
        entries.append(entry)
        return len(entries) - 1

    def accessor(
        self, values: NDArray[Any], *, normalized: bool = False, bounds: bool = False, target: int | None = ARRAY_BUFFER
    ) -> int:
        """Appends an accessor of K ≥ 1 scalars or rows; returns its index.

        Rows of vertex attributes are padded to multiples of four bytes, as glTF requires.

        Args:
            values: float32, uint8, uint16 or uint32, [K] or [K, 1..4].
            normalized: integers stand for 0..1.
            bounds: writes minima and maxima, which positions must have.
        """
        rows = values.reshape(len(values), -1)
        width = rows.shape[1] * rows.itemsize
        stride = width if target == ELEMENT_ARRAY_BUFFER else -(-width // 4) * 4
        data = rows
        if stride != width:
            padded = np.zeros((len(rows), stride), np.uint8)
            padded[:, :width] = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), width)
            data = padded
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self._size, "byteLength": len(rows) * stride}
        if target is not None:
            view["target"] = target
        if stride != width:
            view["byteStride"] = stride
        self._append(np.ascontiguousarray(data).tobytes())
        self._views.append(view)
        accessor: dict[str, Any] = {
            "bufferView": len(self._views) - 1,
            "componentType": _COMPONENTS[rows.dtype.str],
            "count": len(rows),
            "type": _TYPES[rows.shape[1]],
        }
        if normalized:
            accessor["normalized"] = True
        if bounds:
            accessor["min"], accessor["max"] = rows.min(axis=0).tolist(), rows.max(axis=0).tolist()
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def file(self) -> bytes:
        """Serializes the GLB.

        Raises:
            LimitExceededError: the file would be larger than `LARGEST`.
        """
        document = dict(self.document)
        if self._accessors:
            document |= {"accessors": self._accessors, "bufferViews": self._views}
            document["buffers"] = [{"byteLength": self._size}]
        text = json.dumps(document, allow_nan=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = [_CHUNK.pack(len(text), b"JSON"), text]
        if self._size:
            chunks += [_CHUNK.pack(self._size, b"BIN\0"), *self._data]
        size = _HEADER.size + sum(map(len, chunks))
        if size > LARGEST:
            raise LimitExceededError(
                f"a GLB of {size} bytes", field="format", limit=f"{LARGEST} bytes", hint="Export some objects alone."
            )
        return b"".join([_HEADER.pack(b"glTF", 2, size), *chunks])

    def _append(self, data: bytes) -> None:
        padding = bytes(-len(data) % 4)
        self._data += [data, padding]
        self._size += len(data) + len(padding)


def finished(builder: GlbBuilder, nodes: list[int], about: GlbScene) -> bytes:
    """Serializes a document, with nodes and cameras under one upright root.

    Raises:
        LimitExceededError: the file would be larger than `LARGEST`.
    """
    root: dict[str, Any] = {"name": about.name or "scene", "extras": about.extras}
    if children := nodes + add_camera_nodes(builder, about.cameras):
        root["children"] = children
    if (rotation := upright(about.up)) is not None:
        root["rotation"] = rotation
    builder.document["scene"] = builder.add("scenes", {"nodes": [builder.add("nodes", root)]})
    return builder.file()


def upright(up: NDArray[np.float64] | None) -> list[float] | None:
    """Returns the quaternion x y z w of the least rotation from `up` to +y."""
    if up is None:
        return None
    x, y, z = up.tolist()
    if y < -1 + 1e-9:
        return [1.0, 0.0, 0.0, 0.0]
    half = np.array([-z, 0.0, x, 1.0 + y])  # (up × y, 1 + up · y)
    quaternion: list[float] = (half / np.linalg.norm(half)).tolist()
    return quaternion


def add_camera_nodes(builder: GlbBuilder, cameras: Sequence[PosedCamera]) -> list[int]:
    """Adds camera nodes with exact intrinsics in `extras`, which glTF cameras cannot express."""
    nodes = []
    for number, posed in enumerate(cameras):
        lens = posed.camera
        camera = builder.add(
            "cameras",
            {
                "type": "perspective",
                "perspective": {
                    "aspectRatio": lens.width / lens.height,
                    "yfov": 2 * math.atan(lens.height / (2 * lens.fy)),
                    "znear": _NEAREST,
                },
            },
        )
        pose = posed.world_from_camera
        intrinsics = {"width": lens.width, "height": lens.height, "fx": lens.fx, "fy": lens.fy, "cx": lens.cx}
        node: dict[str, Any] = {
            "name": posed.name or f"camera {number}",
            "camera": camera,
            "translation": pose[:3, 3].tolist(),
            "rotation": list(quaternion_of(pose[:3, :3] @ _OPENGL_FROM_OPENCV)),
            "extras": {**intrinsics, "cy": lens.cy},
        }
        nodes.append(builder.add("nodes", node))
    return nodes


def linear(srgb: NDArray[np.floating]) -> NDArray[np.uint16]:
    """Decodes sRGB 0..1 (IEC 61966-2-1) to linear uint16, as glTF stores vertex colors."""
    clipped = np.clip(srgb, 0.0, 1.0)
    decoded = np.where(clipped <= 0.04045, clipped / 12.92, ((clipped + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.rint(decoded * 65_535), np.uint16)


_UNLIT = "KHR_materials_unlit"


def mesh_glb(
    points: F32,  # [V, 3], scene units
    normals: F32,  # [V, 3], unit length or zero
    colors: NDArray[np.uint8],  # [V, 3], sRGB
    labels: NDArray[np.uint16],  # [V]
    confidence: F32,  # [V]
    faces: NDArray[np.int64],  # [F, 3], counter-clockwise seen from outside
    groups: Sequence[NamedRows],  # rows are faces
    about: GlbScene,
) -> bytes:
    """Builds a GLB with a node per group of faces.

    Vertices have `POSITION`, `NORMAL`, `COLOR_0`, `_LABEL` (dictionary id) and `_CONFIDENCE` (0..1). The material is
    unlit because the colors hold the light of the photos.

    Raises:
        LimitExceededError: the file would be larger than a GLB can be.
    """
    builder = GlbBuilder("FAST-Splat scene service")
    nodes = []
    if groups:
        builder.document["extensionsUsed"] = [_UNLIT]
        builder.add("materials", {"name": "photos", "extensions": {_UNLIT: {}}, "doubleSided": True})
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.where(lengths > 0.5, normals / np.maximum(lengths, 1e-9), np.array([0, 1, 0], np.float32))
    for group in groups:
        check_cancelled()
        rows, corners = np.unique(faces[group.rows], return_inverse=True)
        attributes = {
            "POSITION": builder.accessor(points[rows], bounds=True),
            "NORMAL": builder.accessor(np.asarray(unit[rows], np.float32)),
            "COLOR_0": builder.accessor(linear(colors[rows] / 255), normalized=True),
            "_LABEL": builder.accessor(labels[rows]),
            "_CONFIDENCE": builder.accessor(confidence[rows]),
        }
        indices = builder.accessor(corners.reshape(-1).astype(np.uint32), target=ELEMENT_ARRAY_BUFFER)
        primitive = {"attributes": attributes, "indices": indices, "material": 0}
        mesh = builder.add("meshes", {"name": group.name, "primitives": [primitive]})
        nodes.append(builder.add("nodes", {"name": group.name, "mesh": mesh, "extras": group.extras}))
    return finished(builder, nodes, about)
