"""Splat files of other tools: what is written comes back, row by row, and hostile bytes give typed errors."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from fastsplat.service.capture.uploads.splat_files.rows import SplatLimits, SplatRows
from fastsplat.service.capture.uploads.splat_files.splat_reading import (
    SplatFile,
    describe_invisible,
    is_splat_file,
    read_splat_file,
)
from fastsplat.service.scene.artefact.scene import SH_C0, Gaussians
from fastsplat.service.scene.formats.ply import write_ply
from fastsplat.service.scene.formats.sog_writing import sog_bytes
from fastsplat.service.scene.formats.spz_writing import spz_bytes
from fastsplat.service.splatting.raster.rendering import sh_to_rgb
from fastsplat_contract.errors import FastSplatError, InvalidInputError, LimitExceededError
from tests.capture.splat_writers import columns_of, spz_content, write_compressed, write_ksplat, write_spz, write_table
from tests.scene.conftest import make_gaussians

_LIMITS = SplatLimits(100_000, "SOME_SETTING")
_TRIALS = 300
_FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")


def read(path: Path) -> SplatFile:
    return read_splat_file(path, path.name, _LIMITS)


def assert_same(gaussians: Gaussians, rows: SplatRows) -> None:
    for field in _FIELDS:
        np.testing.assert_array_equal(getattr(gaussians, field), getattr(rows, field))


def assert_same_rotations(actual: np.ndarray, expected: np.ndarray, atol: float) -> None:
    """Quaternions of any length; one and its negative are the same rotation."""
    actual, expected = (quats / np.linalg.norm(quats, axis=1, keepdims=True) for quats in (actual, expected))
    signs = np.sign((actual * expected).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(actual * signs, expected, atol=atol)


def assert_close(rows: SplatRows, expected: Gaussians, means: float, scales: float, quats: float, color: float) -> None:
    """Within these errors; opacities and constant colors are bytes."""
    np.testing.assert_allclose(rows.means, expected.means, atol=means)
    np.testing.assert_allclose(rows.log_scales, expected.log_scales, atol=scales)
    assert_same_rotations(rows.quats, expected.quats, quats)
    shares = [1 / (1 + np.exp(-logits)) for logits in (rows.logit_opacities, expected.logit_opacities)]
    np.testing.assert_allclose(*shares, atol=0.5 / 255 + 1e-5)
    np.testing.assert_allclose(rows.sh[:, 0], expected.sh[:, 0], atol=0.5 / 255 / color + 1e-5)


@pytest.mark.parametrize("sh", [1, 4, 9, 16])
@pytest.mark.parametrize("count", [1, 66_000])
def test_our_own_export_comes_back_to_the_bit(tmp_path: Path, count: int, sh: int) -> None:
    gaussians = make_gaussians(count, sh, 0)
    write_ply(gaussians, tmp_path / "a.ply")
    file = read(tmp_path / "a.ply")
    assert_same(gaussians, file.rows)
    assert (file.format, file.invisible, describe_invisible("a.ply", file)) == ("3DGS PLY", 0, ())


@pytest.mark.parametrize(("kind", "text"), [("float", False), ("double", False), ("float", True)])
def test_order_type_and_encoding_of_properties_do_not_matter(tmp_path: Path, kind: str, text: bool) -> None:
    gaussians = make_gaussians(20_000 if text else 300, 4, 0)
    columns = columns_of(gaussians)
    shuffled = {name: columns[name] for name in np.random.default_rng(0).permutation(list(columns))}
    shuffled["confidence"] = np.arange(len(gaussians), dtype=np.uint8)
    write_table(tmp_path / "a.ply", shuffled, kind, text=text)
    assert is_splat_file(tmp_path / "a.ply")
    assert_same(gaussians, read(tmp_path / "a.ply").rows)


def test_elements_before_and_behind_the_gaussians_are_skipped(tmp_path: Path) -> None:
    gaussians = make_gaussians(30, 1, 0)
    write_table(tmp_path / "a.ply", columns_of(gaussians))
    data = (tmp_path / "a.ply").read_bytes()
    data = data.replace(b"element vertex", b"element extrinsic 2\nproperty double m\nelement vertex")
    data = data.replace(b"end_header\n", b"element faces 1\nproperty list uchar int indices\nend_header\n" + bytes(16))
    (tmp_path / "b.ply").write_bytes(data + b"\x01\0\0\0\0")
    assert_same(gaussians, read(tmp_path / "b.ply").rows)


def test_colors_as_bytes_are_the_constant_coefficient(tmp_path: Path) -> None:
    columns = columns_of(make_gaussians(50, 1, 0))
    rgb = np.random.default_rng(0).integers(0, 256, (50, 3)).astype(np.uint8)
    for index, name in enumerate(("red", "green", "blue")):
        del columns[f"f_dc_{index}"]
        columns[name] = rgb[:, index]
    write_table(tmp_path / "a.ply", columns)
    sh = read(tmp_path / "a.ply").rows.sh[:, 0]
    np.testing.assert_allclose(0.5 + SH_C0 * sh, rgb / 255, atol=1e-6)


@pytest.mark.parametrize("sh", [1, 4, 9, 16])
@pytest.mark.parametrize("chunk_colors", [True, False])
def test_a_compressed_ply_comes_back_within_its_steps(tmp_path: Path, sh: int, chunk_colors: bool) -> None:
    source = make_gaussians(700, sh, 0)
    gaussians = replace(source, sh=np.clip(source.sh, -1.7, 1.7))
    write_compressed(tmp_path / "a.compressed.ply", gaussians, chunk_colors=chunk_colors)
    assert is_splat_file(tmp_path / "a.compressed.ply")
    file = read(tmp_path / "a.compressed.ply")
    assert file.format == "compressed PLY" and file.invisible == 0
    rows = file.rows
    assert_close(rows, gaussians, 8 / 1023 / 2 + 1e-5, 8 / 1023 / 2 + 1e-5, 4e-3, SH_C0)
    np.testing.assert_allclose(rows.sh[:, 1:], gaussians.sh[:, 1:], atol=8 / 256 / 2 + 1e-5)


@pytest.mark.parametrize("sh", [1, 4, 9, 16])
@pytest.mark.parametrize(("version", "rotation"), [(2, 0.12), (3, 3e-3)])
def test_spz_comes_back_within_its_steps(tmp_path: Path, sh: int, version: int, rotation: float) -> None:
    source = make_gaussians(500, sh, 0)
    gaussians = replace(source, sh=np.clip(source.sh, -0.9, 0.9))
    write_spz(tmp_path / "a.spz", gaussians, version)
    assert is_splat_file(tmp_path / "a.spz")
    rows = read(tmp_path / "a.spz").rows
    assert_close(rows, gaussians, 0.5 / 4096 + 1e-6, 1 / 32 + 1e-5, rotation, 0.15)
    np.testing.assert_allclose(rows.sh[:, 1:], gaussians.sh[:, 1:], atol=0.5 / 128 + 1e-5)


def test_axes_of_spz_turn_with_their_harmonics(tmp_path: Path) -> None:
    """Seen from the turned place, what was turned has the same color."""
    gaussians = replace(source := make_gaussians(200, 16, 0), sh=np.clip(source.sh, -0.9, 0.9))
    content = spz_content(gaussians)  # its axes are turned against those of `gaussians`
    raw = np.frombuffer(content, np.uint8)[-200 * 45 :].reshape(200, 15, 3)
    stored = np.concatenate([gaussians.sh[:, :1], (raw.astype(np.float32) - 128) / 128], axis=1)
    write_spz(tmp_path / "a.spz", gaussians)
    rows = read(tmp_path / "a.spz").rows
    turn = np.array([1, -1, -1], np.float32)
    eye = np.array([3.0, -2.0, 5.0], np.float32)
    seen = _colors(rows.means * turn, stored, eye * turn)
    np.testing.assert_allclose(_colors(rows.means, np.concatenate([stored[:, :1], rows.sh[:, 1:]], axis=1), eye), seen)


def _colors(means: np.ndarray, sh: np.ndarray, eye: np.ndarray) -> np.ndarray:
    tensors = [torch.from_numpy(np.ascontiguousarray(array)) for array in (means, sh, eye)]
    colors: np.ndarray = sh_to_rgb(tensors[0], tensors[1], tensors[2], 3, backend="cpu").numpy()
    return np.round(colors, 4)


@pytest.mark.parametrize(
    ("name", "value"), [("x", np.nan), ("opacity", np.nan), ("scale_1", np.inf), ("f_dc_2", -np.inf), ("rot_3", np.nan)]
)
def test_a_row_that_cannot_be_shown_keeps_its_number(tmp_path: Path, name: str, value: float) -> None:
    gaussians = make_gaussians(40, 4, 0)
    columns = {key: column.copy() for key, column in columns_of(gaussians).items()}
    columns[name][[7, 30]] = value
    write_table(tmp_path / "a.ply", columns)
    file = read(tmp_path / "a.ply")
    assert (file.invisible, file.first_invisible) == (2, 7)
    assert "row 7" in describe_invisible("a.ply", file)[0]
    rest = np.delete(np.arange(40), [7, 30])
    for field in _FIELDS:
        values = getattr(file.rows, field)
        assert np.isfinite(values).all()
        np.testing.assert_array_equal(values[rest], getattr(gaussians, field)[rest])
    assert (1 / (1 + np.exp(-file.rows.logit_opacities[[7, 30]])) < 1 / 255).all()


def test_infinite_logits_and_thin_gaussians_are_shown(tmp_path: Path) -> None:
    columns = {name: column.copy() for name, column in columns_of(make_gaussians(3, 1, 0)).items()}
    columns["opacity"][:2] = (np.inf, -np.inf)
    columns["scale_0"][2] = -np.inf
    write_table(tmp_path / "a.ply", columns)
    file = read(tmp_path / "a.ply")
    opacities = 1 / (1 + np.exp(-file.rows.logit_opacities))
    assert file.invisible == 0 and opacities[0] > 1 - 1e-6 and opacities[1] < 1e-6
    assert np.isfinite(file.rows.log_scales).all() and np.exp(file.rows.log_scales[2, 0]) < 1e-12


def test_a_file_without_one_row_that_can_be_shown(tmp_path: Path) -> None:
    columns = {name: np.full(5, np.nan) for name in columns_of(make_gaussians(5, 1, 0))}
    write_table(tmp_path / "a.ply", columns)
    with pytest.raises(InvalidInputError, match="no row that can be shown"):
        read(tmp_path / "a.ply")


def test_the_limit_is_checked_before_anything_is_read(tmp_path: Path) -> None:
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 100001\nproperty float x\nend_header\n"
    (tmp_path / "a.ply").write_text(header)
    (tmp_path / "a.spz").write_bytes(gzip.compress(struct.pack("<4sIIBBBB", b"NGSP", 3, 2**32 - 1, 0, 12, 0, 0)))
    for name in ("a.ply", "a.spz"):
        with pytest.raises(LimitExceededError) as caught:
            read(tmp_path / name)
        assert caught.value.field == name and "SOME_SETTING" in str(caught.value.limit)


def _without(name: str) -> Callable[[bytes], bytes]:
    return lambda data: data.replace(f"property float {name}\n".encode(), f"property float other_{name}\n".encode())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_without("opacity"), "no property opacity"),
        (_without("rot_0"), "no property rot_0"),
        (_without("f_rest_3"), "f_rest"),
        (lambda data: data.replace(b"little", b"middle"), "binary_middle_endian"),
        (lambda data: data.replace(b"vertex 9", b"vertex 0"), "no Gaussians"),
        (lambda data: data.replace(b"vertex 9", b"vertex -9"), "element vertex -9"),
        (lambda data: data.replace(b"vertex 9", b"vertex 10"), "bytes where"),
        (lambda data: data.replace(b"vertex 9\n", b"vertex 9\nproperty list uchar int own\n"), "list"),
        (lambda data: data.replace(b"float y", b"float x"), "two properties"),
        (lambda data: data.replace(b"element vertex", b"element point"), "vertex"),
        (lambda data: data.replace(b"end_header", b"endheader"), "header"),
        (lambda data: b"\x89PNG" + data, "not a PLY"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, change: Callable[[bytes], bytes], message: str) -> None:
    write_table(tmp_path / "a.ply", columns_of(make_gaussians(9, 4, 0)))
    (tmp_path / "a.ply").write_bytes(change((tmp_path / "a.ply").read_bytes()))
    with pytest.raises(InvalidInputError, match=message) as caught:
        read(tmp_path / "a.ply")
    assert caught.value.field == "a.ply" and caught.value.hint


def test_ascii_rows_of_another_length_or_without_numbers(tmp_path: Path) -> None:
    write_table(tmp_path / "a.ply", columns_of(make_gaussians(9, 1, 0)), text=True)
    lines = (tmp_path / "a.ply").read_text().splitlines()
    for row, message in ((" ".join(lines[-1].split()[1:]), "row 8"), (f"?{lines[-1]}", "no number"), ("", "row 8")):
        (tmp_path / "a.ply").write_text("\n".join([*lines[:-1], row]) + "\n")
        with pytest.raises(InvalidInputError, match=message):
            read(tmp_path / "a.ply")


def test_spz_that_is_not_read(tmp_path: Path) -> None:
    gaussians = make_gaussians(5, 4, 0)
    content, streams = spz_content(gaussians), spz_bytes(gaussians, 4)
    path = tmp_path / "a.spz"
    for data, message in (
        (gzip.compress(content[:4] + b"\x04" + content[5:]), "version 4 with gzip"),
        (gzip.compress(content[:4] + b"\x01" + content[5:]), "version 1"),
        (gzip.compress(content[:12] + b"\x04" + content[13:]), "degree 4"),
        (gzip.compress(content[:13] + b"\x20" + content[14:]), "fractional bits"),
        (gzip.compress(content + b"\0"), "goes on"),
        (gzip.compress(content[:-1]), "ends within its sh"),
        (streams[:-1], "other sizes"),
        (streams[:40], "other sizes"),
        (streams[:16] + b"\x08" + streams[17:], "no table"),
        (streams[:128] + bytes(4) + streams[132:], "not a whole stream"),
        (streams[:14] + b"\2" + streams[15:16] + b"\x2c" + streams[17:32] + _system(9) + streams[32:], "swapped"),
    ):
        path.write_bytes(data)
        with pytest.raises(InvalidInputError, match=message):
            read(path)


def _system(number: int) -> bytes:
    """The record of an extension of SPZ that says what the axes are."""
    return struct.pack("<III", 0xADBE0003, 4, number)


def test_axes_that_an_spz_states_become_those_of_a_ply(tmp_path: Path) -> None:
    """Right, down, front as in a PLY: what is stored stays; in each container, without gzip, too."""
    gaussians = make_gaussians(50, 16, 0)
    content, streams = spz_content(gaussians, bits=12), spz_bytes(gaussians, 4)
    unknown = struct.pack("<II", 1, 2) + b"??"
    old = content[:14] + b"\2" + content[15:]
    new = streams[:14] + b"\2" + streams[15:16] + b"\x36" + streams[17:32] + unknown + _system(6) + streams[32:]
    for name, plain, stated in (("old", content, old + _system(6) + unknown), ("new", streams, new)):
        (tmp_path / "plain.spz").write_bytes(plain)
        (tmp_path / f"{name}.spz").write_bytes(stated)
        first, second = read(tmp_path / "plain.spz").rows, read(tmp_path / f"{name}.spz").rows
        np.testing.assert_array_equal(second.means * (1, -1, -1), first.means)
        np.testing.assert_array_equal(second.quats * (1, 1, -1, -1), first.quats)
        assert (second.sh[:, 0] == first.sh[:, 0]).all() and (second.sh[:, 1] == -first.sh[:, 1]).all()


@pytest.mark.parametrize("level", [0, 1, 2])
def test_ksplat_comes_back_within_its_steps(tmp_path: Path, level: int) -> None:
    """Two sections: of full buckets and one that is not full, without and with harmonics."""
    gaussians = replace(source := make_gaussians(44, 4, 0), sh=np.clip(source.sh, -1.4, 1.4))
    write_ksplat(tmp_path / "a.ksplat", gaussians, level)
    rows = read(tmp_path / "a.ksplat").rows
    assert_close(rows, gaussians, 2e-3 if level else 0, 1e-3, 1e-3, SH_C0)
    np.testing.assert_allclose(rows.sh[20:, 1:], gaussians.sh[20:, 1:], atol=(1e-6, 1e-3, 0.01)[level])
    assert not rows.sh[:20, 1:].any()


@pytest.mark.parametrize("kind", ["plain", "text", "compressed", "spz", "spz4", "sog", "ksplat"])
def test_damaged_bytes_give_typed_errors_or_gaussians(tmp_path: Path, kind: str) -> None:
    gaussians = make_gaussians(260, 4, 0)
    path = tmp_path / {"spz": "a.spz", "spz4": "a.spz", "sog": "a.sog", "ksplat": "a.ksplat"}.get(kind, "a.ply")
    if kind == "spz":
        content = spz_content(gaussians)
    elif kind in ("spz4", "sog"):
        content = spz_bytes(gaussians, 4) if kind == "spz4" else sog_bytes(gaussians)
    elif kind == "ksplat":
        write_ksplat(path, gaussians, 1)
        content = path.read_bytes()
    else:
        if kind == "compressed":
            write_compressed(path, gaussians)
        else:
            write_table(path, columns_of(gaussians), text=kind == "text")
        content = path.read_bytes()
    rng = np.random.default_rng(0)
    refused, read_whole = 0, 0
    for trial in range(_TRIALS):
        data = bytearray(content)
        if trial % 3 == 0:
            data = data[: rng.integers(len(data))]
        near = 1_500 if trial % 3 == 1 else len(data)
        for _ in range(rng.integers(1, 4)):
            if data:
                data[rng.integers(min(near, len(data)))] = rng.integers(256)
        path.write_bytes(gzip.compress(bytes(data), 1) if kind == "spz" else bytes(data))
        try:
            file = read(path)
        except FastSplatError as error:
            refused += error.field == path.name
        else:
            read_whole += all(np.isfinite(getattr(file.rows, field)).all() for field in _FIELDS)
    assert refused > 100 and refused + read_whole == _TRIALS


def test_other_plys_are_no_splats(tmp_path: Path) -> None:
    write_table(tmp_path / "points.ply", {name: np.zeros(3) for name in "xyz"})
    assert not is_splat_file(tmp_path / "points.ply")
    (tmp_path / "photo.jpg").write_bytes(b"ply scale_0 opacity end_header")
    assert not is_splat_file(tmp_path / "photo.jpg")


def test_a_file_of_another_program_shows_what_the_same_program_wrote_in_another_format(test_data: Path) -> None:
    """Reads splat-transform's `.splat` fixtures, which hold values in the axes of a PLY."""
    folder = test_data / "import_fixtures" / "splat_transform_fixtures"
    if not folder.is_dir():
        pytest.skip("the data folder has no import_fixtures")
    row = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("quats", "u1", 4)])
    truth = np.fromfile(folder / "minimal.splat", row)
    for name in ("minimal.splat", "minimal.ksplat", "minimal-v3.spz", "minimal-v4.spz"):
        rows = read(folder / name).rows
        np.testing.assert_array_equal(rows.means, truth["means"])
        np.testing.assert_allclose(np.exp(rows.log_scales), truth["scales"], rtol=1 / 30)
        rgba = np.concatenate([0.5 + SH_C0 * rows.sh[:, 0], 1 / (1 + np.exp(-rows.logit_opacities[:, None]))], axis=1)
        np.testing.assert_allclose(rgba, truth["rgba"] / 255, atol=0.01)
    assert len(read(folder / "minimal-v2.spz").rows) == len(read(folder / "minimal-raw.spz").rows) == len(truth)
