"""Reads and writes scene folders, which are immutable once written.

Files: `scene.json`, `gaussians.safetensors`, `cameras.json`, and optionally `evidence.safetensors`,
`things.safetensors` and `parts.safetensors`.
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from fastsplat.service.common.atomic import atomic_directory
from fastsplat.service.scene.artefact.alignment import frame_name
from fastsplat.service.scene.artefact.arrays import (
    Array,
    Shapes,
    check_evidence,
    check_membership,
    digest_arrays,
    evidence_shapes,
    first_non_finite,
    head_shapes,
    map_arrays,
    save_arrays,
    scene_shapes,
)
from fastsplat.service.scene.artefact.scene import F32, Evidence, Gaussians, Parts, Scene, SemanticHead, Thing, Things
from fastsplat.service.scene.artefact.scene_manifest import (
    Manifest,
    cameras_from_bytes,
    cameras_to_bytes,
    manifest_from_bytes,
    manifest_to_bytes,
)
from fastsplat_contract.errors import ConflictError, InvalidInputError, NotFoundError, SceneFileError

_MANIFEST = "scene.json"
_ARRAYS = "gaussians.safetensors"
_CAMERAS = "cameras.json"
_EVIDENCE = "evidence.safetensors"
_THINGS = "things.safetensors"
_PARTS = "parts.safetensors"
_MAX_JSON_BYTES = 256 << 20


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
    if bad := first_non_finite(arrays):
        raise InvalidInputError(f"{bad} holds NaN or infinite numbers", field=bad, hint="Drop those Gaussians first.")
    evidence, membership, parts = _evidence_of(scene), _membership_of(scene), _parts_of(scene)
    cameras = cameras_to_bytes(scene.cameras)
    manifest = manifest_to_bytes(
        Manifest(
            dictionary=scene.dictionary,
            text_encoder=scene.text_encoder,
            label_templates=scene.label_templates,
            scale=scene.scale,
            training=scene.training,
            quality=scene.quality,
            facts=scene.facts,
            gaussians=len(scene.gaussians),
            sh=scene.gaussians.sh.shape[1],
            code=scene.gaussians.codes.shape[1],
            embedding=scene.label_embeddings.shape[1],
            arrays_sha256=digest_arrays(arrays),
            evidence_entries=len(evidence["counts"]) if evidence else None,
            evidence_sha256=digest_arrays(evidence) if evidence else "",
            things=None if scene.things is None else scene.things.table,
            things_entries=len(membership["counts"]) if membership else 0,
            things_sha256=digest_arrays(membership) if membership else "",
            things_classes=None if scene.things is None or scene.things.head is None else len(scene.things.head.bias),
            next_thing_id=0 if scene.things is None else scene.things.next_id,
            parts=None if scene.things is None or scene.things.parts is None else scene.things.parts.table,
            parts_entries=len(parts["counts"]) if parts else 0,
            parts_sha256=digest_arrays(parts) if parts else "",
            groups=() if scene.things is None else scene.things.groups,
            scaling=scene.scaling,
            alignment=scene.alignment,
            observations=scene.observations,
        ),
        cameras,
    )
    try:
        with atomic_directory(folder, replace=False) as beside:
            save_arrays(arrays, beside / _ARRAYS)
            if evidence:
                save_arrays(evidence, beside / _EVIDENCE)
            if membership:
                save_arrays(membership, beside / _THINGS)
            if parts:
                save_arrays(parts, beside / _PARTS)
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
    shapes = scene_shapes(manifest.gaussians, manifest.sh, manifest.code, len(manifest.dictionary), manifest.embedding)
    arrays: dict[str, F32] = _mapped(folder / _ARRAYS, shapes, manifest.arrays_sha256)
    if bad := first_non_finite(arrays):
        raise SceneFileError(f"{_ARRAYS} has NaN or infinite numbers in {bad}", field=_ARRAYS, hint=_RESTORE)
    return Scene(
        gaussians=Gaussians(**{field.name: arrays[field.name] for field in fields(Gaussians)}),
        head=SemanticHead(arrays["head.weight"], arrays["head.bias"]),
        dictionary=manifest.dictionary,
        label_embeddings=arrays["label_embeddings"],
        text_encoder=manifest.text_encoder,
        label_templates=manifest.label_templates,
        cameras=cameras_from_bytes(cameras_bytes, frame_name(manifest.alignment)),
        scale=manifest.scale,
        training=manifest.training,
        quality=manifest.quality,
        facts=manifest.facts,
        evidence=_read_evidence(folder / _EVIDENCE, manifest),
        things=_read_things(folder, manifest),
        scaling=manifest.scaling,
        alignment=manifest.alignment,
        observations=manifest.observations,
    )


_RESTORE = "Restore the scene's folder from a backup, or train it again."


def _arrays_of(scene: Scene) -> dict[str, F32]:
    arrays: dict[str, F32] = {field.name: getattr(scene.gaussians, field.name) for field in fields(Gaussians)}
    return arrays | {
        "head.weight": scene.head.weight,
        "head.bias": scene.head.bias,
        "label_embeddings": scene.label_embeddings,
    }


def _evidence_of(scene: Scene) -> dict[str, Array]:
    if scene.evidence is None:
        return {}
    if wrong := check_evidence(scene.evidence, len(scene.dictionary)):
        raise InvalidInputError(f"the evidence contradicts the scene: {wrong}", field="evidence")
    return {field.name: getattr(scene.evidence, field.name) for field in fields(Evidence)}


def _membership_of(scene: Scene) -> dict[str, Array]:
    if scene.things is None:
        return {}
    if wrong := check_membership(scene.things.membership, [thing.id for thing in scene.things.table]):
        raise InvalidInputError(f"the things contradict the scene: {wrong}", field="things")
    arrays = {field.name: getattr(scene.things.membership, field.name) for field in fields(Evidence)}
    head = scene.things.head
    if head is None:
        return arrays
    of_head: dict[str, Array] = {"head.weight": head.weight, "head.bias": head.bias}
    if bad := first_non_finite({"head.weight": head.weight, "head.bias": head.bias}):
        raise InvalidInputError(f"the things' {bad} holds NaN or infinite numbers", field="things.head")
    return arrays | of_head


def _parts_of(scene: Scene) -> dict[str, Array]:
    parts = None if scene.things is None else scene.things.parts
    if parts is None:
        return {}
    if wrong := check_membership(parts.membership, [part.id for part in parts.table]):
        raise InvalidInputError(f"the parts contradict the scene: {wrong}", field="things")
    return {field.name: getattr(parts.membership, field.name) for field in fields(Evidence)}


def _read_evidence(path: Path, manifest: Manifest) -> Evidence | None:
    if manifest.evidence_entries is None:
        return None
    shapes = evidence_shapes(manifest.gaussians, manifest.evidence_entries)
    evidence = _sparse_counts(path, _mapped(path, shapes, manifest.evidence_sha256))
    if wrong := check_evidence(evidence, len(manifest.dictionary)):
        raise _damaged(path, wrong)
    return evidence


def _read_things(folder: Path, manifest: Manifest) -> Things | None:
    if manifest.things is None:
        return None
    path = folder / _THINGS
    classes, shapes = manifest.things_classes, evidence_shapes(manifest.gaussians, manifest.things_entries)
    arrays = _mapped(
        path, shapes if classes is None else {**shapes, **head_shapes(classes, manifest.code)}, manifest.things_sha256
    )
    head = None
    if classes is not None:
        head = SemanticHead(arrays.pop("head.weight"), arrays.pop("head.bias"))
        if bad := first_non_finite({"head.weight": head.weight, "head.bias": head.bias}):
            raise _damaged(path, f"{bad} has NaN or infinite numbers")
    membership = _members(path, _sparse_counts(path, arrays), manifest.things)
    parts = None
    if manifest.parts is not None:
        path = folder / _PARTS
        arrays = _mapped(path, evidence_shapes(manifest.gaussians, manifest.parts_entries), manifest.parts_sha256)
        parts = Parts(manifest.parts, _members(path, _sparse_counts(path, arrays), manifest.parts))
    return Things(manifest.things, membership, manifest.next_thing_id, parts, head, manifest.groups)


def _members(path: Path, membership: Evidence, table: tuple[Thing, ...]) -> Evidence:
    if wrong := check_membership(membership, [thing.id for thing in table]):
        raise _damaged(path, wrong)
    return membership


def _sparse_counts(path: Path, arrays: dict[str, Any]) -> Evidence:
    if arrays["starts"][0] != 0 or arrays["starts"][-1] != len(arrays["counts"]):
        raise _damaged(path, "its rows do not cover it")
    return Evidence(**arrays)


def _damaged(path: Path, what: str) -> SceneFileError:
    return SceneFileError(f"{path.name} is damaged: {what}", field=path.name, hint=_RESTORE)


def _mapped(path: Path, shapes: Shapes, sha256: str) -> dict[str, Any]:
    arrays = map_arrays(path, shapes)
    if digest_arrays(arrays) != sha256:
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
