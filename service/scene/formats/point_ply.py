"""Exports labelled points as a PLY for point cloud programs."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.artefact.scene import F32
from fastsplat.service.scene.formats.ply import ply_header

_ROW = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")),
        *((name, "u1") for name in ("red", "green", "blue")),
        *((name, "<u2") for name in ("label", "object")),
        ("confidence", "<f4"),
    ]
)
_TYPES = {"f4": "float", "u1": "uchar", "u2": "ushort"}


def point_ply(
    points: F32,  # [P, 3], scene units
    normals: F32,  # [P, 3], unit length
    colors: NDArray[np.uint8],  # [P, 3], sRGB
    labels: NDArray[np.uint16],  # [P], 0 for none
    objects: NDArray[np.uint16],  # [P], 0 for none
    confidence: F32,  # [P], 0..1
    comments: Mapping[str, str | float | Mapping[int, str]],
) -> bytes:
    """Builds a binary little-endian PLY with the properties of `_ROW`.

    Args:
        comments: header lines by their first word. Texts, and names by id, are written as ASCII JSON strings, so that
            no name can end its line: `comment object 7 "banana"`.
    """
    rows = np.empty(len(points), _ROW)
    for names, columns in (
        (("x", "y", "z"), points),
        (("nx", "ny", "nz"), normals),
        (("red", "green", "blue"), colors),
    ):
        for axis, name in enumerate(names):
            rows[name] = columns[:, axis]
    rows["label"], rows["object"], rows["confidence"] = labels, objects, confidence
    lines: list[str] = []
    for word, value in comments.items():
        if isinstance(value, Mapping):
            lines += [f"{word} {number} {json.dumps(name)}" for number, name in value.items()]
        else:
            lines.append(f"{word} {json.dumps(value)}")
    properties = [(_TYPES[_ROW[name].str[1:]], name) for name in _ROW.names or ()]
    return ply_header(len(rows), properties, lines) + rows.tobytes()


def point_rows(content: bytes) -> NDArray[np.void]:
    """Reads the vertices of a file of `point_ply` as structured rows."""
    return np.frombuffer(content, _ROW, offset=content.index(b"end_header\n") + len(b"end_header\n"))
