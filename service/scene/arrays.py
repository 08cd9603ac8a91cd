"""The arrays of a scene as one safetensors file that is read by mapping it into memory."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from service.scene.errors import SceneFileError
from service.scene.types import F32

_CHUNK_BYTES = 16 << 20

Shapes = Mapping[str, tuple[int, ...]]
"""Name to shape of every array of the file."""


def scene_shapes(gaussians: int, sh: int, code: int, labels: int, embedding: int) -> Shapes:
    """What the file holds, given G, K = (degree + 1)², D, N and E; all float32."""
    return {
        "means": (gaussians, 3),
        "quats": (gaussians, 4),
        "log_scales": (gaussians, 3),
        "logit_opacities": (gaussians,),
        "sh": (gaussians, sh, 3),
        "codes": (gaussians, code),
        "head.weight": (labels + 1, code),
        "head.bias": (labels + 1,),
        "label_embeddings": (labels, embedding),
    }


def save_arrays(arrays: Mapping[str, F32], path: Path) -> None:
    """Write float32 arrays to `path`; the bytes depend on the arrays alone."""
    save_file({name: np.ascontiguousarray(array) for name, array in arrays.items()}, path)


def map_arrays(path: Path, shapes: Shapes) -> dict[str, F32]:
    """Read-only views into the mapped file, one for each of `shapes`.

    Raises:
        SceneFileError: not a whole safetensors file, or other names, dtypes or shapes than `shapes`.
    """
    try:
        with safe_open(path, framework="np") as file:  # the library's strict parser: offsets, overlaps, length
            names = set(file.keys())
            found = {name: (file.get_slice(name).get_dtype(), file.get_slice(name).get_shape()) for name in names}
        with path.open("rb") as raw:
            header_bytes = int.from_bytes(raw.read(8), "little")
            header = json.loads(raw.read(header_bytes))
    except (SafetensorError, OSError, ValueError) as error:
        raise _damaged(path, f"cannot be read: {error}") from error
    if names != set(shapes):
        raise _damaged(path, f"holds the arrays {sorted(names)}, expected {sorted(shapes)}")
    for name, shape in shapes.items():
        if found[name] != ("F32", list(shape)):
            raise _damaged(path, f"has {name} as {found[name][0]} {found[name][1]}, expected F32 {list(shape)}")
    start = 8 + header_bytes
    if start % 4:
        raise _damaged(path, "has arrays that are not aligned to four bytes")
    mapped = np.memmap(path, dtype=np.uint8, mode="r")
    arrays: dict[str, F32] = {}
    for name, shape in shapes.items():
        begin, end = header[name]["data_offsets"]
        arrays[name] = np.asarray(mapped[start + begin : start + end]).view(np.float32).reshape(shape)
    return arrays


def first_non_finite(arrays: Mapping[str, F32]) -> str:
    """Name of the first array that holds NaN or infinity, or ""."""
    for name, array in arrays.items():
        if not all(np.isfinite(chunk).all() for chunk in _chunks(array)):
            return name
    return ""


def digest_arrays(arrays: Mapping[str, F32]) -> str:
    """sha256, in hex, over name, shape and little-endian values of every array: equal digests mean that row i of one
    scene is row i of the other, to the bit."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(f"{name} {list(arrays[name].shape)}\n".encode())
        for chunk in _chunks(arrays[name]):
            digest.update(np.ascontiguousarray(chunk, dtype="<f4").view(np.uint8).data)
    return digest.hexdigest()


def _chunks(array: F32) -> Iterator[F32]:
    """Flat pieces of bounded size, so that a million Gaussians need no copy of themselves."""
    flat = np.ascontiguousarray(array).reshape(-1)
    step = _CHUNK_BYTES // flat.itemsize
    for start in range(0, len(flat), step):
        yield flat[start : start + step]


def _damaged(path: Path, what: str) -> SceneFileError:
    return SceneFileError(
        f"{path.name} {what}", field=path.name, hint="Restore the scene's folder from a backup, or train it again."
    )
