"""Writes splat files as other tools do, from Gaussians; the inverse of `service.capture.uploads.splat_files`."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fastsplat.service.scene.artefact.scene import SH_C0, Gaussians


def columns_of(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """The standard properties in the standard order."""
    rest = gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(len(gaussians), -1)
    return {
        **dict(zip("xyz", gaussians.means.T, strict=True)),
        **{f"f_dc_{i}": gaussians.sh[:, 0, i] for i in range(3)},
        **{f"f_rest_{i}": rest[:, i] for i in range(rest.shape[1])},
        "opacity": gaussians.logit_opacities,
        **{f"scale_{i}": gaussians.log_scales[:, i] for i in range(3)},
        **{f"rot_{i}": gaussians.quats[:, i] for i in range(4)},
    }


def write_table(path: Path, columns: Mapping[str, np.ndarray], kind: str = "float", *, text: bool = False) -> None:
    """A PLY of one element, its columns in the order of the mapping; columns of bytes are `uchar`."""
    kinds = {name: "uchar" if column.dtype == np.uint8 else kind for name, column in columns.items()}
    count = len(next(iter(columns.values())))
    header = ["ply", f"format {'ascii' if text else 'binary_little_endian'} 1.0", "comment made by a test"]
    header += [f"element vertex {count}", *(f"property {kinds[name]} {name}" for name in columns), "end_header", ""]
    if text:
        rows = [" ".join(str(value) for value in row) for row in zip(*columns.values(), strict=True)]
        path.write_text("\n".join(header) + "\n".join(rows) + "\n")
        return
    dtypes = {"float": "<f4", "double": "<f8", "uchar": "u1"}
    table = np.empty(count, np.dtype([(name, dtypes[kinds[name]]) for name in columns]))
    for name, column in columns.items():
        table[name] = column
    path.write_bytes("\n".join(header).encode() + table.tobytes())


def write_compressed(path: Path, gaussians: Gaussians, *, chunk_colors: bool = True) -> None:
    """A compressed PLY as SuperSplat writes it."""
    count = len(gaussians)
    chunk = np.arange(count) // 256
    colors = gaussians.sh[:, 0] * SH_C0 + 0.5
    bounds, shares = [], []
    for values in (gaussians.means, gaussians.log_scales, colors):
        low = np.stack([values[chunk == number].min(axis=0) for number in range(chunk[-1] + 1)])
        high = np.stack([values[chunk == number].max(axis=0) for number in range(chunk[-1] + 1)])
        bounds.append(np.concatenate([low, high], axis=1))
        shares.append((values - low[chunk]) / np.maximum(high - low, 1e-9)[chunk])
    if not chunk_colors:
        bounds, shares[2] = bounds[:2], np.clip(colors, 0, 1)
    opacity = _opacities(gaussians)
    vertex = np.stack(
        [
            _packed(shares[0], (11, 10, 11)),
            _packed_rotations(gaussians.quats),
            _packed(shares[1], (11, 10, 11)),
            _packed(np.concatenate([shares[2], opacity[:, None]], axis=1), (8, 8, 8, 8)),
        ],
        axis=1,
    )
    axes = [f"{end}_{group}{axis}" for group in ("", "scale_") for end in ("min", "max") for axis in "xyz"]
    names = axes + [f"{end}_{channel}" for end in ("min", "max") for channel in "rgb"]
    names = names[: 6 * len(bounds)]
    header = ["ply", "format binary_little_endian 1.0", f"element chunk {chunk[-1] + 1}"]
    header += [f"property float {name}" for name in names] + [f"element vertex {count}"]
    header += [f"property uint packed_{name}" for name in ("position", "rotation", "scale", "color")]
    rest = gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(count, -1)
    if rest.shape[1]:
        header += [f"element sh {count}", *(f"property uchar f_rest_{i}" for i in range(rest.shape[1]))]
    body = np.concatenate(bounds, axis=1).astype("<f4").tobytes() + vertex.astype("<u4").tobytes()
    body += np.clip(np.trunc((rest / 8 + 0.5) * 256), 0, 255).astype(np.uint8).tobytes()
    path.write_bytes("\n".join([*header, "end_header", ""]).encode() + body)


def write_spz(path: Path, gaussians: Gaussians, version: int = 3, *, bits: int = 12) -> None:
    """An SPZ file as Niantic's library writes it, whose axes are right, up, back."""
    path.write_bytes(gzip.compress(spz_content(gaussians, version, bits=bits)))


def write_ksplat(path: Path, gaussians: Gaussians, level: int) -> None:
    """A `.ksplat` of two sections, the first 20 without harmonics; buckets of 8 around centers on whole numbers."""
    body, heads = b"", b""
    for begin, end, degree in ((0, 20, 0), (20, len(gaussians), 1)):
        part, sizes = slice(begin, end), [8] * ((end - begin) // 8)
        rest = end - begin - sum(sizes)
        bucket = np.repeat(np.arange(len(sizes) + 1), [*sizes, rest])[: end - begin]
        centers = np.round(gaussians.means[part][np.arange(0, end - begin, 8)])
        steps, block = 32_767, 16.0
        means = np.rint((gaussians.means[part] - centers[bucket]) / (block / 2) * steps + steps) if level else None
        kinds = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))[level]
        sh = gaussians.sh[part, 1:4].transpose(0, 2, 1).reshape(end - begin, -1)[:, : 9 * degree]
        rgba = np.concatenate([gaussians.sh[part, 0] * SH_C0 + 0.5, _opacities(gaussians)[part, None]], axis=1)
        columns = [
            (gaussians.means[part] if means is None else means).astype(kinds[0]),
            np.exp(gaussians.log_scales[part]).astype(kinds[1]),
            gaussians.quats[part].astype(kinds[1]),
            _bytes(rgba * 255),
            _bytes((sh + 1.5) / 3 * 255) if level == 2 else sh.astype(kinds[2]),
        ]
        rows = np.concatenate([np.ascontiguousarray(column).view(np.uint8) for column in columns], axis=1)
        body += (struct.pack("<I", rest) if rest else b"") + centers.astype("<f4").tobytes() + rows.tobytes()
        head = struct.pack("<IIIIfHxxI", end - begin, end - begin, 8, len(centers), block, 12, steps)
        heads += (head + struct.pack("<4xIIH", len(sizes), int(rest > 0), degree)).ljust(1024, b"\0")
    top = struct.pack("<BB2xII4xIH14xff", 0, 1, 2, 2, len(gaussians), level, -1.5, 1.5).ljust(4096, b"\0")
    path.write_bytes(top + heads + body)


def _opacities(gaussians: Gaussians) -> np.ndarray:
    return np.asarray(1 / (1 + np.exp(-gaussians.logit_opacities)))


def spz_content(gaussians: Gaussians, version: int = 3, *, bits: int = 12) -> bytes:
    """What is inside the gzip stream."""
    count, flip = len(gaussians), np.array([1, -1, -1])
    fixed = np.rint(gaussians.means * flip * (1 << bits)).astype("<i4")
    w, xyz = gaussians.quats[:, :1], gaussians.quats[:, 1:] * flip
    quats = np.concatenate([xyz, w], axis=1)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    if version == 2:
        rotations = _bytes(127.5 * quats[:, :3] * np.where(quats[:, 3:] < 0, -1, 1) + 127.5)
    else:
        rotations = np.frombuffer(b"".join(_smallest_three(quat) for quat in quats), np.uint8)
    # Where y and z change their signs, a harmonic does as its polynomial in them: y, z, x; xy, yz, z², xz, x²−y²; ...
    powers = [1, 1, 0, 1, 2, 2, 1, 2, 3, 2, 3, 3, 2, 3, 2][: gaussians.sh.shape[1] - 1]
    higher = gaussians.sh[:, 1:] * ((-1.0) ** np.array(powers))[:, None]
    return b"".join(
        [
            struct.pack("<4sIIBBBB", b"NGSP", version, count, gaussians.sh_degree, bits, 0, 0),
            fixed.reshape(-1, 1).view(np.uint8)[:, :3].tobytes(),
            _bytes(255 * _opacities(gaussians)).tobytes(),
            _bytes(gaussians.sh[:, 0] * 0.15 * 255 + 127.5).tobytes(),
            _bytes((gaussians.log_scales + 10) * 16).tobytes(),
            rotations.tobytes(),
            _bytes(higher * 128 + 128).tobytes(),
        ]
    )


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.clip(np.rint(values), 0, 255), np.uint8)


def _packed(shares: np.ndarray, widths: tuple[int, ...]) -> np.ndarray:
    word = np.zeros(len(shares), np.uint32)
    for column, width in enumerate(widths):
        top = (1 << width) - 1
        word = word << np.uint32(width) | np.clip(np.rint(shares[:, column] * top), 0, top).astype(np.uint32)
    return word


def _packed_rotations(quats: np.ndarray) -> np.ndarray:
    unit = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    words = np.empty(len(quats), np.uint32)
    for row, quat in enumerate(unit):
        largest = int(np.abs(quat).argmax())
        rest = np.delete(quat * np.sign(quat[largest]), largest) * np.sqrt(0.5) + 0.5
        words[row] = np.uint32(largest << 30) | _packed(rest[None], (10, 10, 10))[0]
    return words


def _smallest_three(quat: np.ndarray) -> bytes:
    largest = int(np.abs(quat).argmax())
    word = largest
    for value in np.delete(quat * np.sign(quat[largest]), largest):
        word = word << 10 | (512 if value < 0 else 0) | round(511 * abs(float(value)) / np.sqrt(0.5))
    return word.to_bytes(4, "little")
