"""PLY files: exact round trips, the standard layout, and no trust in headers."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.scene.formats.ply import read_ply, write_ply
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from tests.scene.conftest import assert_same_gaussians, make_gaussians


def rows_of(gaussians: Gaussians, rows: np.ndarray) -> Gaussians:
    return Gaussians(**{field.name: getattr(gaussians, field.name)[rows] for field in fields(Gaussians)})


@pytest.mark.parametrize("sh", [1, 4, 9, 16])
@pytest.mark.parametrize("count", [0, 1, 70_000])
def test_round_trip_is_exact(tmp_path: Path, count: int, sh: int) -> None:
    gaussians = make_gaussians(count, sh, 0)
    write_ply(gaussians, tmp_path / "a.ply")
    assert_same_gaussians(gaussians, read_ply(tmp_path / "a.ply"))


def test_the_layout_is_the_one_viewers_know(tmp_path: Path) -> None:
    gaussians = make_gaussians(5)
    write_ply(gaussians, tmp_path / "a.ply")
    header, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)
    lines = header.decode().splitlines()
    assert lines[:3] == ["ply", "format binary_little_endian 1.0", "element vertex 5"]
    expected = (
        "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 "
        + " ".join(f"f_rest_{i}" for i in range(45))
        + " opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
    )
    assert lines[3:] == [f"property float {name}" for name in expected.split()]
    table = np.frombuffer(body, dtype="<f4").reshape(5, 62)
    np.testing.assert_array_equal(table[:, 3:6], 0)
    for channel in range(3):  # channel-major: all red coefficients, then green, then blue
        np.testing.assert_array_equal(table[:, 9 + 15 * channel : 24 + 15 * channel], gaussians.sh[:, 1:, channel])
    np.testing.assert_array_equal(table[:, 54], gaussians.logit_opacities)
    np.testing.assert_array_equal(table[:, 58:], gaussians.quats)


def test_chosen_rows_keep_the_scene_order(tmp_path: Path) -> None:
    gaussians = make_gaussians(40, code=0)
    mask = np.random.default_rng(0).random(40) < 0.3
    write_ply(gaussians, tmp_path / "mask.ply", rows=mask)
    shuffled = np.random.default_rng(1).permutation(np.flatnonzero(mask))
    write_ply(gaussians, tmp_path / "ids.ply", rows=shuffled)
    assert_same_gaussians(rows_of(gaussians, mask), read_ply(tmp_path / "mask.ply"))
    assert (tmp_path / "mask.ply").read_bytes() == (tmp_path / "ids.ply").read_bytes()
    write_ply(gaussians, tmp_path / "none.ply", rows=np.zeros(40, dtype=bool))
    assert len(read_ply(tmp_path / "none.ply")) == 0


@pytest.mark.parametrize("rows", [np.ones(39, dtype=bool), np.array([40]), np.array([-1])])
def test_rows_that_are_not_there(tmp_path: Path, rows: np.ndarray) -> None:
    with pytest.raises(InvalidInputError):
        write_ply(make_gaussians(40), tmp_path / "a.ply", rows=rows)
    assert list(tmp_path.iterdir()) == []


def test_order_and_extra_properties_are_free(tmp_path: Path) -> None:
    gaussians = make_gaussians(7, 4, 0)
    write_ply(gaussians, tmp_path / "a.ply")
    header, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)
    names = [line.split()[2] for line in header.decode().splitlines()[3:]]
    table = np.frombuffer(body, dtype=[(name, "<f4") for name in names])
    order = [str(name) for name in np.random.default_rng(0).permutation(names) if name not in ("nx", "ny", "nz")]
    mixed = np.zeros(7, dtype=[("red", "u1")] + [(name, "<f4") for name in order] + [("when", "<f8")])
    for name in order:
        mixed[name] = table[name]
    lines = ["ply", "format binary_little_endian 1.0", "comment made elsewhere", "element vertex 7"]
    lines += ["property uchar red"]
    lines += [f"property float32 {name}" for name in order] + ["property double when", "end_header", ""]
    (tmp_path / "b.ply").write_bytes("\r\n".join(lines).encode() + mixed.tobytes())
    assert_same_gaussians(gaussians, read_ply(tmp_path / "b.ply"))


def test_every_truncation_is_found(tmp_path: Path) -> None:
    write_ply(make_gaussians(4), tmp_path / "a.ply")
    whole = (tmp_path / "a.ply").read_bytes()
    for length in [*range(0, len(whole), 41), len(whole) - 1]:
        (tmp_path / "b.ply").write_bytes(whole[:length])
        with pytest.raises(InvalidInputError):
            read_ply(tmp_path / "b.ply")
    (tmp_path / "b.ply").write_bytes(whole + b"\x00")
    with pytest.raises(InvalidInputError):
        read_ply(tmp_path / "b.ply")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"vertex 4", b"vertex 1000000000000"),
        (b"vertex 4", b"vertex -4"),
        (b"vertex 4", b"vertex 4e0"),
        (b"vertex 4", b"vertex " + b"9" * 5000),
        (b"vertex 4", b"vertex 4\nelement face 0"),
        (b"binary_little_endian", b"binary_big_endian"),
        (b"ply\n", b"plx\n"),
        (b"property float x\n", b"property list uchar int x\n"),
        (b"property float x\n", b"property float y\n"),
        (b"property float x\n", b"property double x\n"),
        (b"property float f_rest_44\n", b""),
        (b"property float opacity\n", b"property float opacities\n"),
        (b"property float x\n", b"property float x\n" + b"comment " + b"x" * 70_000 + b"\n"),
        (b"property float x\n", "property float é\n".encode()),
        (b"end_header", b"end_heading"),
    ],
)
def test_hostile_headers(tmp_path: Path, old: bytes, new: bytes) -> None:
    write_ply(make_gaussians(4), tmp_path / "a.ply")
    whole = (tmp_path / "a.ply").read_bytes()
    assert old in whole
    (tmp_path / "b.ply").write_bytes(whole.replace(old, new, 1))
    with pytest.raises((InvalidInputError, LimitExceededError)):
        read_ply(tmp_path / "b.ply")


def test_ascii_with_a_trillion_rows(tmp_path: Path) -> None:
    header = "ply\nformat ascii 1.0\nelement vertex 1000000000000\nproperty float x\nend_header\n"
    (tmp_path / "a.ply").write_text(header)
    with pytest.raises(InvalidInputError, match="ascii"):
        read_ply(tmp_path / "a.ply")


def test_numbers_must_be_finite(tmp_path: Path) -> None:
    gaussians = make_gaussians(4)
    gaussians.log_scales[2, 1] = np.nan
    write_ply(gaussians, tmp_path / "a.ply")
    with pytest.raises(InvalidInputError, match="scale_1 of row 2"):
        read_ply(tmp_path / "a.ply")


def test_the_bound_on_rows(tmp_path: Path) -> None:
    write_ply(make_gaussians(4), tmp_path / "a.ply")
    with pytest.raises(LimitExceededError):
        read_ply(tmp_path / "a.ply", max_gaussians=3)


def test_a_point_cloud_is_not_gaussians(test_data: Path) -> None:
    with pytest.raises(InvalidInputError, match="f_dc_0"):
        read_ply(test_data / "import_fixtures" / "brush_test_dataset" / "init.ply")


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError):
        read_ply(tmp_path / "nothing.ply")
