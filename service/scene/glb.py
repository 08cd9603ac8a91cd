"""glTF 2.0 binary files: one JSON chunk, one buffer."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.errors import LimitExceededError
from fastsplat_contract.poses import quaternion_of

_HEADER = struct.Struct("<4sII")
_CHUNK = struct.Struct("<I4s")
_COMPONENTS = {"<f4": 5126, "|u1": 5121, "<u2": 5123, "<u4": 5125}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
LARGEST = (1 << 32) - 1
"""Bytes of a file: the format counts them in 32 bits."""

_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])
_NEAREST = 0.01


@dataclass(frozen=True)
class NamedRows:
    """A node of a file.

    Attributes:
        name: for people.
        extras: what programs are told of it, JSON-ready.
        rows: int64 [K], K ≥ 1: its Gaussians, vertices or faces.
    """

    name: str
    extras: dict[str, Any]
    rows: NDArray[np.int64]


@dataclass(frozen=True)
class GlbScene:
    """What a file says beside its shapes.

    Attributes:
        name: of the scene.
        extras: of the scene, JSON-ready.
        up: float64 [3], the unit vector up of the world frame, which the file's root turns to +y; None if unknown.
        cameras: of the scene.
    """

    name: str
    extras: dict[str, Any]
    up: NDArray[np.float64] | None
    cameras: Sequence[PosedCamera]


class GlbBuilder:
    """Collects a glTF document and its buffer.

    Attributes:
        document: the glTF object so far, without what `file` adds (buffers, bufferViews, accessors).
    """

    def __init__(self, generator: str) -> None:
        self.document: dict[str, Any] = {"asset": {"version": "2.0", "generator": generator}}
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._data: list[bytes] = []
        self._size = 0

    def add(self, kind: str, entry: dict[str, Any]) -> int:
        """The index of an entry appended to one of the document's lists ("nodes", "meshes", ...)."""
        entries: list[dict[str, Any]] = self.document.setdefault(kind, [])
        entries.append(entry)
        return len(entries) - 1

    def accessor(
        self, values: NDArray[Any], *, normalized: bool = False, bounds: bool = False, target: int | None = ARRAY_BUFFER
    ) -> int:
        """The index of an accessor of an array [K], or [K, 1..4], of float32, uint8, uint16 or uint32; rows of vertex
        attributes are padded to multiples of four bytes, as glTF asks.

        Args:
            values: K ≥ 1 elements.
            normalized: integers stand for 0..1.
            bounds: the smallest and largest values are written too, which positions must have.
            target: what the buffer view is for.
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
        """The GLB.

        Raises:
            LimitExceededError: larger than the format can say.
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
                f"a GLB of {size} bytes", field="format", limit=f"{LARGEST} bytes", hint="Export some things alone."
            )
        return b"".join([_HEADER.pack(b"glTF", 2, size), *chunks])

    def _append(self, data: bytes) -> None:
        padding = bytes(-len(data) % 4)
        self._data += [data, padding]
        self._size += len(data) + len(padding)


def finished(builder: GlbBuilder, nodes: list[int], about: GlbScene) -> bytes:
    """The file of a document whose shapes are complete: their nodes and the cameras under one root, which is upright.

    Raises:
        LimitExceededError: larger than a GLB can be.
    """
    root: dict[str, Any] = {"name": about.name or "scene", "extras": about.extras}
    if children := nodes + add_camera_nodes(builder, about.cameras):
        root["children"] = children
    if (rotation := upright(about.up)) is not None:
        root["rotation"] = rotation
    builder.document["scene"] = builder.add("scenes", {"nodes": [builder.add("nodes", root)]})
    return builder.file()


def upright(up: NDArray[np.float64] | None) -> list[float] | None:
    """The quaternion x y z w of the least rotation that turns a unit vector up to glTF's, +y; None without one."""
    if up is None:
        return None
    x, y, z = up.tolist()
    if y < -1 + 1e-9:
        return [1.0, 0.0, 0.0, 0.0]
    half = np.array([-z, 0.0, x, 1.0 + y])  # (up × y, 1 + up · y)
    quaternion: list[float] = (half / np.linalg.norm(half)).tolist()
    return quaternion


def add_camera_nodes(builder: GlbBuilder, cameras: Sequence[PosedCamera]) -> list[int]:
    """The nodes of a scene's cameras, each with its exact intrinsics in `extras`; a glTF camera itself looks through
    the middle of its picture and has square pixels."""
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
    """uint16, 0 to 65535 for 0 to 1: sRGB values 0..1 decoded (IEC 61966-2-1), as glTF has vertex colors."""
    clipped = np.clip(srgb, 0.0, 1.0)
    decoded = np.where(clipped <= 0.04045, clipped / 12.92, ((clipped + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.rint(decoded * 65_535), np.uint16)
