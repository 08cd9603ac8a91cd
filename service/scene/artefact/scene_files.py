"""Reads and writes scene folders, which are immutable once written.

Files: `scene.json`, `gaussians.safetensors`, `cameras.json`, and optionally `evidence.safetensors`,
`objects.safetensors` and `parts.safetensors`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from fastsplat.service.common.array_files import write_arrays
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.files import atomic_directory
from fastsplat.service.scene.artefact.alignment import frame_name
from fastsplat.service.scene.artefact.scene import F32, Evidence, Gaussians, Object, Objects, Parts, Scene, SemanticHead
from fastsplat.service.scene.artefact.scene_facts import split_quality
from fastsplat.service.scene.artefact.scene_manifest import (
    Manifest,
    Stored,
    cameras_from_bytes,
    cameras_to_bytes,
    manifest_from_bytes,
    manifest_to_bytes,
    object_of_row,
)
from fastsplat_contract.errors import ConflictError, InvalidInputError, NotFoundError, SceneFileError

_MANIFEST = "scene.json"
_ARRAYS = "gaussians.safetensors"
_CAMERAS = "cameras.json"
_EVIDENCE = "evidence.safetensors"
_OBJECTS = "objects.safetensors"
_PARTS = "parts.safetensors"
_MAX_JSON_BYTES = 256 << 20

_CHUNK_BYTES = 16 << 20
_CODES: Mapping[str, np.dtype[np.generic]] = {"F32": np.dtype("<f4"), "I64": np.dtype("<i8"), "U16": np.dtype("<u2")}

_Array = NDArray[np.generic]
_Shapes = Mapping[str, tuple[str, tuple[int, ...]]]
"""Safetensors dtype name and shape of each array of a file, by array name."""


def write_scene(scene: Scene, folder: Path) -> None:
    """Writes `scene` to the new folder `folder` atomically.

    Raises:
        ConflictError: `folder` exists; a scene version is never overwritten.
        InvalidInputError: an array is not float32 or not finite, evidence or membership is inconsistent, or
            training/quality is not JSON.
    """
    if folder.exists():
        raise _exists(folder)
    arrays = _arrays_of(scene)
    for name, array in arrays.items():
        if array.dtype != np.float32:
            raise InvalidInputError(f"{name} is {array.dtype}, expected float32", field=name)
    if bad := _first_non_finite(arrays):
        raise InvalidInputError(f"{bad} holds NaN or infinite numbers", field=bad, hint="Drop those Gaussians first.")
    evidence, membership, parts = _evidence_of(scene), _membership_of(scene), _parts_of(scene)
    cameras = cameras_to_bytes(scene.cameras)
    manifest = manifest_to_bytes(
        scene,
        _digest_arrays(arrays),
        _stored(evidence) if evidence else None,
        _stored(membership),
        _stored(parts),
        cameras,
    )
    try:
        with atomic_directory(folder, replace=False) as beside:
            _save_arrays(arrays, beside / _ARRAYS)
            if evidence:
                _save_arrays(evidence, beside / _EVIDENCE)
            if membership:
                _save_arrays(membership, beside / _OBJECTS)
            if parts:
                _save_arrays(parts, beside / _PARTS)
            (beside / _CAMERAS).write_bytes(cameras)
            (beside / _MANIFEST).write_bytes(manifest)
    except FileExistsError as error:  # another writer was faster
        raise _exists(folder) from error


def read_scene(folder: Path) -> Scene:
    """Reads a scene folder, checks its digests, and maps its arrays read-only.

    Raises:
        NotFoundError: the folder does not exist, or was removed just now.
        SceneSchemaError: written under another schema.
        SceneFileError: any other damage; the message names the file.
    """
    try:
        return _read_scene(folder)
    except (OSError, SceneFileError):
        if not folder.is_dir():
            raise NotFoundError(f"there is no scene folder {folder.name}", field="scene") from None
        raise


def _read_scene(folder: Path) -> Scene:
    cameras_bytes = _read(folder / _CAMERAS)
    manifest = manifest_from_bytes(_read(folder / _MANIFEST), cameras_bytes)
    sizes = manifest.sizes
    shapes = _scene_shapes(sizes.gaussians, sizes.sh, sizes.code, len(manifest.entries), sizes.embedding)
    arrays: dict[str, F32] = _mapped(folder / _ARRAYS, shapes, manifest.arrays_sha256)
    if bad := _first_non_finite(arrays):
        raise SceneFileError(f"{_ARRAYS} has NaN or infinite numbers in {bad}", field=_ARRAYS, hint=_RESTORE)
    facts, quality = split_quality(manifest.quality)
    return Scene(
        gaussians=Gaussians(**{field.name: arrays[field.name] for field in fields(Gaussians)}),
        head=SemanticHead(arrays["head.weight"], arrays["head.bias"]),
        dictionary=Dictionary(manifest.entries),
        label_embeddings=arrays["label_embeddings"],
        text_encoder=(manifest.text_encoder.name, manifest.text_encoder.sha256),
        label_templates=manifest.label_templates,
        cameras=cameras_from_bytes(cameras_bytes, frame_name(manifest.alignment)),
        scale=manifest.scale,
        training=manifest.training,
        quality=quality,
        facts=facts,
        evidence=_read_evidence(folder / _EVIDENCE, manifest),
        objects=_read_objects(folder, manifest),
        scaling=manifest.scaling,
        alignment=manifest.alignment,
        observations=manifest.observations,
    )


_RESTORE = "Restore the scene's folder from a backup, or train it again."


def _stored(sparse: Mapping[str, _Array]) -> Stored:
    return {"entries": len(sparse["counts"]), "sha256": _digest_arrays(sparse)} if sparse else {}


def _arrays_of(scene: Scene) -> dict[str, F32]:
    arrays: dict[str, F32] = {field.name: getattr(scene.gaussians, field.name) for field in fields(Gaussians)}
    return arrays | {
        "head.weight": scene.head.weight,
        "head.bias": scene.head.bias,
        "label_embeddings": scene.label_embeddings,
    }


def _evidence_of(scene: Scene) -> dict[str, _Array]:
    if scene.evidence is None:
        return {}
    if wrong := _check_evidence(scene.evidence, len(scene.dictionary)):
        raise InvalidInputError(f"the evidence contradicts the scene: {wrong}", field="evidence")
    return {field.name: getattr(scene.evidence, field.name) for field in fields(Evidence)}


def _membership_of(scene: Scene) -> dict[str, _Array]:
    if scene.objects is None:
        return {}
    if wrong := _check_membership(scene.objects.membership, [obj.id for obj in scene.objects.table]):
        raise InvalidInputError(f"the objects contradict the scene: {wrong}", field="objects")
    arrays = {field.name: getattr(scene.objects.membership, field.name) for field in fields(Evidence)}
    head = scene.objects.head
    if head is None:
        return arrays
    of_head: dict[str, F32] = {"head.weight": head.weight, "head.bias": head.bias}
    if bad := _first_non_finite(of_head):
        raise InvalidInputError(f"the objects' {bad} holds NaN or infinite numbers", field="objects.head")
    return {**arrays, **of_head}


def _parts_of(scene: Scene) -> dict[str, _Array]:
    parts = None if scene.objects is None else scene.objects.parts
    if parts is None:
        return {}
    if wrong := _check_membership(parts.membership, [part.id for part in parts.table]):
        raise InvalidInputError(f"the parts contradict the scene: {wrong}", field="objects")
    return {field.name: getattr(parts.membership, field.name) for field in fields(Evidence)}


def _read_evidence(path: Path, manifest: Manifest) -> Evidence | None:
    stored = manifest.evidence
    if stored is None:
        return None
    shapes = _evidence_shapes(manifest.sizes.gaussians, stored.entries)
    evidence = _sparse_counts(path, _mapped(path, shapes, stored.sha256))
    if wrong := _check_evidence(evidence, len(manifest.entries)):
        raise _damaged(path, wrong)
    return evidence


def _read_objects(folder: Path, manifest: Manifest) -> Objects | None:
    stored, gaussians = manifest.objects, manifest.sizes.gaussians
    if stored is None:
        return None
    path, classes, shapes = folder / _OBJECTS, stored.classes, _evidence_shapes(gaussians, stored.entries)
    arrays = _mapped(
        path, shapes if classes is None else {**shapes, **_head_shapes(classes, manifest.sizes.code)}, stored.sha256
    )
    head = None
    if classes is not None:
        of_head = {name: arrays.pop(name) for name in ("head.weight", "head.bias")}
        if bad := _first_non_finite(of_head):
            raise _damaged(path, f"{bad} has NaN or infinite numbers")
        head = SemanticHead(*of_head.values())
    table = tuple(map(object_of_row, stored.table))
    membership = _members(path, _sparse_counts(path, arrays), table)
    parts = None
    if stored.parts is not None:
        path, part_table = folder / _PARTS, tuple(map(object_of_row, stored.parts.table))
        arrays = _mapped(path, _evidence_shapes(gaussians, stored.parts.entries), stored.parts.sha256)
        parts = Parts(part_table, _members(path, _sparse_counts(path, arrays), part_table))
    return Objects(table, membership, stored.next_id, parts, head, stored.groups)


def _members(path: Path, membership: Evidence, table: tuple[Object, ...]) -> Evidence:
    if wrong := _check_membership(membership, [obj.id for obj in table]):
        raise _damaged(path, wrong)
    return membership


def _sparse_counts(path: Path, arrays: dict[str, Any]) -> Evidence:
    if arrays["starts"][0] != 0 or arrays["starts"][-1] != len(arrays["counts"]):
        raise _damaged(path, "its rows do not cover it")
    return Evidence(**arrays)


def _damaged(path: Path, what: str) -> SceneFileError:
    return SceneFileError(f"{path.name} is damaged: {what}", field=path.name, hint=_RESTORE)


def _mapped(path: Path, shapes: _Shapes, sha256: str) -> dict[str, Any]:
    arrays = _map_arrays(path, shapes)
    if _digest_arrays(arrays) != sha256:
        raise SceneFileError(f"{path.name} does not match its digest in {_MANIFEST}", field=path.name, hint=_RESTORE)
    return arrays


def _read(path: Path) -> bytes:
    try:
        if path.stat().st_size > _MAX_JSON_BYTES:
            raise SceneFileError(
                f"{path.name} has {path.stat().st_size} bytes", field=path.name, limit=f"{_MAX_JSON_BYTES} bytes"
            )
        return path.read_bytes()
    except OSError as error:
        raise SceneFileError(f"{path.name} cannot be read: {error}", field=path.name, hint=_RESTORE) from error


def _exists(folder: Path) -> ConflictError:
    return ConflictError(
        f"the scene folder {folder.name} exists", field="scene", hint="Write a new version into a new folder."
    )


def _scene_shapes(gaussians: int, sh: int, code: int, labels: int, embedding: int) -> _Shapes:
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
    return {name: ("F32", shape) for name, shape in shapes.items()} | _head_shapes(labels + 1, code)


def _evidence_shapes(gaussians: int, entries: int) -> _Shapes:
    """Returns the arrays of an evidence file with G Gaussians and M entries."""
    return {"starts": ("I64", (gaussians + 1,)), "labels": ("U16", (entries,)), "counts": ("I64", (entries,))}


def _head_shapes(classes: int, code: int) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Returns the arrays of an affine map from D code dimensions to C classes."""
    return {"head.weight": ("F32", (classes, code)), "head.bias": ("F32", (classes,))}


def _check_evidence(evidence: Evidence, labels: int) -> str:
    """Describes the first error in evidence over `labels` labels; "" if it is valid."""
    if int(evidence.labels.max(initial=0)) > labels:
        return f"it holds the label {int(evidence.labels.max())}, and the dictionary has {labels}"
    return _check_entries(evidence)


def _check_membership(membership: Evidence, ids: Sequence[int]) -> str:
    """Describes the first error in a membership of these objects; "" if it is valid."""
    strangers = np.setdiff1d(membership.labels, [0, *ids])
    if len(strangers):
        return f"it holds the object {int(strangers[0])}, which the table does not have"
    return _check_entries(membership)


def _check_entries(evidence: Evidence) -> str:
    if (np.diff(evidence.starts) < 0).any():
        return "its rows do not ascend"
    if int(evidence.counts.min(initial=1)) <= 0:
        return "it holds a count that is not positive"
    rows = np.repeat(np.arange(len(evidence)), np.diff(evidence.starts))
    if (np.diff(rows << 16 | evidence.labels) <= 0).any():
        return "the labels of a row do not ascend"
    return ""


def _save_arrays(arrays: Mapping[str, _Array], path: Path) -> None:
    """Writes arrays to `path`; equal arrays give equal bytes."""
    write_arrays({name: np.ascontiguousarray(array) for name, array in arrays.items()}, path)


def _map_arrays(path: Path, shapes: _Shapes) -> dict[str, _Array]:
    """Maps a file's arrays read-only, without loading them; raises SceneFileError."""
    try:
        with safe_open(path, framework="np") as file:  # the library's strict parser: offsets, overlaps, length
            names = set(file.keys())
            stored = {name: (file.get_slice(name).get_dtype(), file.get_slice(name).get_shape()) for name in names}
        with path.open("rb") as raw:
            header_bytes = int.from_bytes(raw.read(8), "little")
            header = json.loads(raw.read(header_bytes))
    except (SafetensorError, OSError, ValueError) as error:
        raise SceneFileError.of(path.name, f"cannot be read: {error}", _RESTORE) from error
    if names != set(shapes):
        raise SceneFileError.of(path.name, f"holds the arrays {sorted(names)}, expected {sorted(shapes)}", _RESTORE)
    for name, (code, shape) in shapes.items():
        if stored[name] != (code, list(shape)):
            what = f"has {name} as {stored[name][0]} {stored[name][1]}, expected {code} {list(shape)}"
            raise SceneFileError.of(path.name, what, _RESTORE)
    start = 8 + header_bytes
    mapped = np.memmap(path, dtype=np.uint8, mode="r")
    arrays: dict[str, _Array] = {}
    for name, (code, shape) in shapes.items():
        begin, end = header[name]["data_offsets"]
        if (start + begin) % _CODES[code].itemsize:
            raise SceneFileError.of(path.name, f"has {name} at a place that is not aligned to its numbers", _RESTORE)
        arrays[name] = np.asarray(mapped[start + begin : start + end]).view(_CODES[code]).reshape(shape)
    return arrays


def _first_non_finite(arrays: Mapping[str, F32]) -> str:
    """Names the first array that holds NaN or infinity; "" if none does."""
    for name, array in arrays.items():
        if not all(np.isfinite(chunk.view(np.float32)).all() for chunk in _chunks(array)):
            return name
    return ""


def _digest_arrays(arrays: Mapping[str, _Array]) -> str:
    """Returns a SHA-256 hex digest over the arrays' names, shapes and little-endian values."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(f"{name} {list(arrays[name].shape)}\n".encode())
        for chunk in _chunks(arrays[name]):
            digest.update(np.ascontiguousarray(chunk, dtype=chunk.dtype.newbyteorder("<")).view(np.uint8).data)
    return digest.hexdigest()


def _chunks(array: _Array) -> Iterator[_Array]:
    """Yields flat pieces of bounded size, so that large arrays are not copied whole."""
    flat = np.ascontiguousarray(array).reshape(-1)
    step = _CHUNK_BYTES // flat.itemsize
    for start in range(0, len(flat), step):
        yield flat[start : start + step]
