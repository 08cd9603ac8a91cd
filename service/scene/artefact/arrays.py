"""Stores a scene's arrays as memory-mapped safetensors files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from fastsplat.service.common.array_files import write_arrays
from fastsplat.service.scene.artefact.scene import F32, Evidence
from fastsplat_contract.errors import SceneFileError

_CHUNK_BYTES = 16 << 20
_CODES: Mapping[str, np.dtype[np.generic]] = {"F32": np.dtype("<f4"), "I64": np.dtype("<i8"), "U16": np.dtype("<u2")}

Array = NDArray[np.generic]
Shapes = Mapping[str, tuple[str, tuple[int, ...]]]
"""Safetensors dtype name and shape of each array of a file, by array name."""


def scene_shapes(gaussians: int, sh: int, code: int, labels: int, embedding: int) -> Shapes:
    """Returns the scene file's arrays for G, K = (degree + 1)², D, N, E."""
    shapes: dict[str, tuple[int, ...]] = {
        "means": (gaussians, 3),
        "quats": (gaussians, 4),
        "log_scales": (gaussians, 3),
        "logit_opacities": (gaussians,),
        "sh": (gaussians, sh, 3),
        "codes": (gaussians, code),
        "label_embeddings": (labels, embedding),
    }
    return {name: ("F32", shape) for name, shape in shapes.items()} | head_shapes(labels + 1, code)


def evidence_shapes(gaussians: int, entries: int) -> Shapes:
    """Returns the arrays of an evidence file with G Gaussians and M entries."""
    return {"starts": ("I64", (gaussians + 1,)), "labels": ("U16", (entries,)), "counts": ("I64", (entries,))}


def head_shapes(classes: int, code: int) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Returns the arrays of an affine map from D code dimensions to C classes."""
    return {"head.weight": ("F32", (classes, code)), "head.bias": ("F32", (classes,))}


def check_evidence(evidence: Evidence, labels: int) -> str:
    """Describes the first error in evidence over `labels` labels; "" if it is valid."""
    if (np.diff(evidence.starts) < 0).any():
        return "its rows do not ascend"
    if len(evidence.labels) == 0:
        return ""
    if int(evidence.labels.max()) > labels:
        return f"it holds the label {int(evidence.labels.max())}, and the dictionary has {labels}"
    return _check_entries(evidence)


def check_membership(membership: Evidence, ids: Sequence[int]) -> str:
    """Describes the first error in a membership of these things; "" if it is valid."""
    if (np.diff(membership.starts) < 0).any():
        return "its rows do not ascend"
    strangers = np.setdiff1d(membership.labels, [0, *ids])
    if len(strangers):
        return f"it holds the thing {int(strangers[0])}, which the table does not have"
    return _check_entries(membership) if len(membership.labels) else ""


def _check_entries(evidence: Evidence) -> str:
    if int(evidence.counts.min()) <= 0:
        return "it holds a count that is not positive"
    rows = np.repeat(np.arange(len(evidence)), np.diff(evidence.starts))
    if (np.diff(rows << 16 | evidence.labels) <= 0).any():
        return "the labels of a row do not ascend"
    return ""


def save_arrays(arrays: Mapping[str, Array], path: Path) -> None:
    """Writes arrays to `path`; equal arrays give equal bytes."""
    write_arrays({name: np.ascontiguousarray(array) for name, array in arrays.items()}, path)


def map_arrays(path: Path, shapes: Shapes) -> dict[str, Array]:
    """Maps a file's arrays read-only, without loading them.

    Raises:
        SceneFileError: not a complete safetensors file, or names, dtypes or shapes differ from `shapes`.
    """
    try:
        with safe_open(path, framework="np") as file:  # the library's strict parser: offsets, overlaps, length
            names = set(file.keys())
            stored = {name: (file.get_slice(name).get_dtype(), file.get_slice(name).get_shape()) for name in names}
        with path.open("rb") as raw:
            header_bytes = int.from_bytes(raw.read(8), "little")
            header = json.loads(raw.read(header_bytes))
    except (SafetensorError, OSError, ValueError) as error:
        raise _damaged(path, f"cannot be read: {error}") from error
    if names != set(shapes):
        raise _damaged(path, f"holds the arrays {sorted(names)}, expected {sorted(shapes)}")
    for name, (code, shape) in shapes.items():
        if stored[name] != (code, list(shape)):
            raise _damaged(path, f"has {name} as {stored[name][0]} {stored[name][1]}, expected {code} {list(shape)}")
    start = 8 + header_bytes
    mapped = np.memmap(path, dtype=np.uint8, mode="r")
    arrays: dict[str, Array] = {}
    for name, (code, shape) in shapes.items():
        begin, end = header[name]["data_offsets"]
        if (start + begin) % _CODES[code].itemsize:
            raise _damaged(path, f"has {name} at a place that is not aligned to its numbers")
        arrays[name] = np.asarray(mapped[start + begin : start + end]).view(_CODES[code]).reshape(shape)
    return arrays


def first_non_finite(arrays: Mapping[str, F32]) -> str:
    """Names the first array that holds NaN or infinity; "" if none does."""
    for name, array in arrays.items():
        if not all(np.isfinite(chunk.view(np.float32)).all() for chunk in _chunks(array)):
            return name
    return ""


def digest_arrays(arrays: Mapping[str, Array]) -> str:
    """Returns a SHA-256 hex digest over the arrays' names, shapes and little-endian values.

    Scenes with equal digests have bit-identical arrays in the same row order.
    """
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(f"{name} {list(arrays[name].shape)}\n".encode())
        for chunk in _chunks(arrays[name]):
            digest.update(np.ascontiguousarray(chunk, dtype=chunk.dtype.newbyteorder("<")).view(np.uint8).data)
    return digest.hexdigest()


def _chunks(array: Array) -> Iterator[Array]:
    """Yields flat pieces of bounded size, so that large arrays are not copied whole."""
    flat = np.ascontiguousarray(array).reshape(-1)
    step = _CHUNK_BYTES // flat.itemsize
    for start in range(0, len(flat), step):
        yield flat[start : start + step]


def _damaged(path: Path, what: str) -> SceneFileError:
    return SceneFileError.of(path.name, f"{what}", "Restore the scene's folder from a backup, or train it again.")
