"""Points that come with an upload as PLY."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.capture.formats.ply_points import read_points
from fastsplat_contract.errors import FastSplatError, InvalidInputError, LimitExceededError


def _ply(
    form: str, rows: int, body: bytes, properties: str = "float x,float y,float z,uchar red,uchar green,uchar blue"
) -> bytes:
    lines = "".join(f"property {column}\n" for column in properties.split(","))
    return f"ply\nformat {form} 1.0\nelement vertex {rows}\n{lines}end_header\n".encode() + body


def test_ply_forms_say_the_same(tmp_path: Path, settings) -> None:
    xyz = np.array([[0, 0.5, 1], [-1, 2, 3]], np.float32)
    rgb = np.array([[1, 2, 3], [255, 0, 7]], np.uint8)
    text = "".join(" ".join(map(str, [*p.tolist(), *c.tolist()])) + "\n" for p, c in zip(xyz, rgb, strict=True))
    binary = {
        order: b"".join(p.astype(f"{order}f4").tobytes() + c.tobytes() for p, c in zip(xyz, rgb, strict=True))
        for order in "<>"
    }
    bodies = {"ascii": text.encode(), "binary_little_endian": binary["<"], "binary_big_endian": binary[">"]}
    for form, body in bodies.items():
        (tmp_path / "p.ply").write_bytes(_ply(form, 2, body))
        points, colors = read_points(tmp_path / "p.ply", "p.ply", settings)
        np.testing.assert_array_equal(points, xyz)
        np.testing.assert_array_equal(colors, rgb)


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (_ply("ascii", 10**12, b"0 0 0 1 1 1\n"), LimitExceededError),
        (_ply("ascii", 10**6, b"0 0 0 1 1 1\n"), InvalidInputError),
        (_ply("ascii", 10**30, b""), InvalidInputError),
        (_ply("binary_little_endian", 10**6, bytes(15)), InvalidInputError),
        (_ply("ascii", 1, b"0 0 nan 1 1 1\n"), InvalidInputError),
        (_ply("ascii", 1, b"0 0 zero 1 1 1\n"), InvalidInputError),
        (_ply("ascii", 2, b"0 0 0 1 1 1\n" + b" " * 40), InvalidInputError),
        (_ply("ascii", 1, b"0 0\n", "float x,float y"), InvalidInputError),
        (_ply("ascii", 1, b"0 0\n", "list uchar int x"), InvalidInputError),
        (b"ply\nformat ascii 1.0\n", InvalidInputError),
        (b"ply" + b"\n" * 10**6, InvalidInputError),
        (b"not a ply", InvalidInputError),
        (b"", InvalidInputError),
    ],
)
def test_invalid_ply_files_are_refused(
    content: bytes, kind: type[FastSplatError], tmp_path: Path, settings, refused
) -> None:
    (tmp_path / "points3d.ply").write_bytes(content)
    with refused(kind, "points3d.ply"):
        read_points(tmp_path / "points3d.ply", "points3d.ply", settings)


def test_colors_that_are_none_are_the_nearest_that_are(tmp_path: Path, settings) -> None:
    (tmp_path / "p.ply").write_bytes(_ply("ascii", 1, b"0 0 0 300 -5 255\n"))
    assert read_points(tmp_path / "p.ply", "p.ply", settings)[1].tolist() == [[255, 0, 255]]
