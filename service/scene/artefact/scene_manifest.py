"""Encodes and validates `scene.json` and `cameras.json`."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PlainValidator, ValidationError, model_validator

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.scene.artefact.alignment import Alignment, alignment_to_json
from fastsplat.service.scene.artefact.observations import observations_from_json, observations_to_json
from fastsplat.service.scene.artefact.reads import MAX_READ_CHARS, MOST_READS
from fastsplat.service.scene.artefact.scaling import Scaling, scaling_to_json
from fastsplat.service.scene.artefact.scene import (
    SH_COUNTS,
    Looks,
    NameSource,
    Object,
    ObjectGroup,
    Objects,
    Scene,
    SurfaceKind,
)
from fastsplat.service.scene.artefact.suggestions import Suggestion
from fastsplat_contract.errors import FastSplatError, InvalidInputError, SceneFileError, SceneSchemaError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.messages.object_reads import ObjectRead, ReadKind
from fastsplat_contract.messages.scenes import Scale
from fastsplat_contract.photos.observations import Observation

_Share = Annotated[float, Field(ge=0, le=1)]
_Suggestion = tuple[str, _Share] | tuple[str, _Share, str, str, tuple[str, ...]]
"""The source is omitted for suggestions of the scene's own models."""

_Line = Annotated[str, Field(min_length=1, max_length=MAX_READ_CHARS)]
_Read = tuple[ReadKind, _Line, _Share, Annotated[int, Field(ge=1)]]
_Cameras = tuple[Annotated[int, Field(ge=0)], ...]

SCHEMA = 1
"""Version of the folder layout; no other is read or written."""

_FORMAT = "fastsplat-scene"
_RESTORE = "Restore the scene's folder from a backup, or train it again."


def _is_base64(text: str) -> str:
    base64.b64decode(text, validate=True)
    return text


_Base64 = Annotated[str, AfterValidator(_is_base64)]


class _StrictRow(BaseModel):
    """Base of JSON rows: no unknown fields, no type coercion."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class ObjectRow(_StrictRow):
    """An object, or a part of one."""

    id: Annotated[int, Field(ge=1, le=65535)]
    name: str
    source: NameSource | None
    probability: _Share
    consensus: _Share
    surface: SurfaceKind
    suggestions: tuple[_Suggestion, ...]
    parent: Annotated[int, Field(ge=0, le=65535)]
    appearance: _Base64 = ""
    picture: _Base64 = ""
    proposed_in: _Cameras = ()
    missed_in: _Cameras = ()
    reads: Annotated[tuple[_Read, ...], Field(max_length=MOST_READS)] = ()
    looks: tuple[str, _Base64] | None = None

    @model_validator(mode="after")
    def _names_have_a_source(self) -> ObjectRow:
        if bool(self.name) != (self.source is not None):
            raise ValueError(f"the object {self.id} has a name without a source, or the other way round")
        return self


class _Parts(_StrictRow):
    table: list[ObjectRow]
    entries: Annotated[int, Field(ge=0)]
    sha256: str


class _ObjectsRow(_StrictRow):
    """Objects of a scene with their parts and groups."""

    table: list[ObjectRow]
    next_id: Annotated[int, Field(ge=0, le=65536)]
    entries: Annotated[int, Field(ge=0)]
    sha256: str
    classes: Annotated[int, Field(ge=1)] | None
    parts: _Parts | None
    groups: tuple[ObjectGroup, ...]

    @model_validator(mode="after")
    def _refer_to_objects(self) -> _ObjectsRow:
        object_ids, parts = {obj.id for obj in self.table}, [] if self.parts is None else self.parts.table
        part_ids = {part.id for part in parts}
        for rows, used in ((self.table, set()), (parts, object_ids), (self.groups, object_ids | part_ids)):
            ids = [row.id for row in rows]
            if ids != sorted(set(ids)) or used & set(ids):
                raise ValueError("the ids of objects, parts or groups do not ascend, or are used twice")
        if any(obj.parent for obj in self.table) or not {part.parent for part in parts} <= object_ids:
            raise ValueError("a part is of no object, or an object of another")
        for group in self.groups:
            if not set(group.members) <= object_ids:
                raise ValueError(f"members of group {group.id} are no objects")
        return self


def _object_row(obj: Object) -> dict[str, Any]:
    """Encodes an object as JSON with base64 bytes; omits most empty fields."""
    row = asdict(replace(obj, looks=None))
    del row["looks"]
    if obj.looks is not None:
        row["looks"] = obj.looks.sha256, base64.b64encode(obj.looks.embedding).decode()
    for name in ("appearance", "picture"):
        if coded := base64.b64encode(row.pop(name)).decode():
            row[name] = coded
    for name in ("proposed_in", "missed_in", "reads"):
        if not row[name]:
            del row[name]
    row["suggestions"] = [tuple(suggestion) if suggestion.source else suggestion[:2] for suggestion in obj.suggestions]
    return row


def _objects_row(objects: Objects, stored: Stored, parts_stored: Stored) -> dict[str, Any]:
    head, parts = objects.head, objects.parts
    return {
        "table": [_object_row(obj) for obj in objects.table],
        "next_id": objects.next_id,
        **stored,
        "classes": None if head is None else len(head.bias),
        "parts": None if parts is None else {"table": [_object_row(part) for part in parts.table], **parts_stored},
        "groups": [asdict(group) for group in objects.groups],
    }


def object_of_row(row: ObjectRow) -> Object:
    decoded = {name: base64.b64decode(getattr(row, name)) for name in ("appearance", "picture")}
    suggestions = tuple(Suggestion(*values) for values in row.suggestions)
    reads = tuple(ObjectRead(*values) for values in row.reads)
    looks = None if row.looks is None else Looks(row.looks[0], base64.b64decode(row.looks[1]))
    return Object(**{**vars(row), **decoded, "suggestions": suggestions, "reads": reads, "looks": looks})


Stored = Mapping[str, Any]
"""The `entries` of a file of sparse counts, and the `sha256` of its arrays."""


def manifest_to_bytes(
    scene: Scene, arrays_sha256: str, evidence: Stored | None, objects: Stored, parts: Stored, cameras: bytes
) -> bytes:
    """Encodes `scene.json`, with digests of itself and of `cameras.json`.

    Non-finite numbers of training and quality are dropped rather than failing the scene; quality lists them as
    `left_out`.

    Args:
        arrays_sha256: digest of the arrays, also of the row order.
        evidence, objects, parts: what is stored of each; `objects` and `parts` are ignored in scenes without.

    Raises:
        InvalidInputError: training or quality holds values that are not JSON.
    """
    left_out: list[str] = []
    training = _finite(scene.training, "training", left_out)
    quality = _finite(scene.facts.with_quality(scene.quality), "quality", left_out)
    if left_out:
        quality["left_out"] = sorted(left_out)
    body: dict[str, Any] = {
        "format": _FORMAT,
        "schema": SCHEMA,
        "dictionary": [asdict(entry) for entry in scene.dictionary.entries],
        "text_encoder": dict(zip(("name", "sha256"), scene.text_encoder, strict=True)),
        "label_templates": list(scene.label_templates),
        "scale": scene.scale,
        "scaling": scaling_to_json(scene.scaling),
        "alignment": alignment_to_json(scene.alignment),
        "observations": observations_to_json(scene.observations),
        "training": training,
        "quality": quality,
        "sizes": {
            "gaussians": len(scene.gaussians),
            "sh": scene.gaussians.sh.shape[1],
            "code": scene.gaussians.codes.shape[1],
            "embedding": scene.label_embeddings.shape[1],
        },
        "arrays_sha256": arrays_sha256,
        "evidence": evidence,
        "objects": None if scene.objects is None else _objects_row(scene.objects, objects, parts),
        "cameras_sha256": hashlib.sha256(cameras).hexdigest(),
    }
    try:
        body["sha256"] = _seal(body)
        return json.dumps(body, indent=1, allow_nan=False).encode()
    except (TypeError, ValueError, RecursionError) as error:
        raise InvalidInputError(
            f"training or quality cannot be written as JSON: {error}",
            field="training/quality",
            hint="Write numbers, texts, lists and mappings only.",
        ) from error


def manifest_from_bytes(data: bytes, cameras: bytes) -> Manifest:
    """Decodes `scene.json` and checks its digest and that of `cameras.json`.

    Raises:
        SceneSchemaError: another schema version.
        SceneFileError: any other damage.
    """
    body = _parse(data, "scene.json")
    if not isinstance(body, dict) or body.get("format") != _FORMAT:
        raise SceneFileError("scene.json is not a scene manifest", field="scene.json", hint=_RESTORE)
    if body.get("schema") != SCHEMA or isinstance(body["schema"], bool):
        raise SceneSchemaError(
            f"scene.json has schema {body.get('schema')!r}, this version reads {SCHEMA}",
            field="schema",
            hint="With the version of fastsplat that wrote it, export the scene as PLY or SPZ, and import that here.",
        )
    if body.pop("sha256", None) != _seal(body):
        raise SceneFileError("scene.json does not match its own digest", field="scene.json", hint=_RESTORE)
    try:
        manifest = Manifest.model_validate_json(data)
        Dictionary(manifest.entries)  # checks the names
    except (ValidationError, FastSplatError) as error:
        raise SceneFileError(f"scene.json is malformed: {error}", field="scene.json", hint=_RESTORE) from error
    if manifest.cameras_sha256 != hashlib.sha256(cameras).hexdigest():
        raise SceneFileError("cameras.json does not match its digest", field="cameras.json", hint=_RESTORE)
    return manifest


def cameras_to_bytes(cameras: Sequence[PosedCamera]) -> bytes:
    """Encodes `cameras.json`: name, intrinsics in pixels, world_from_camera (row-major, scene units)."""
    rows = [
        {"name": posed.name, **asdict(posed.camera), "world_from_camera": posed.world_from_camera.tolist()}
        for posed in cameras
    ]
    return json.dumps(rows, indent=1, allow_nan=False).encode()


def cameras_from_bytes(data: bytes, frame_id: str) -> tuple[PosedCamera, ...]:
    """Decodes `cameras.json`, whose poses are in that frame.

    Raises:
        SceneFileError: malformed, or a pose that is not rigid.
    """
    rows = _parse(data, "cameras.json")
    try:
        return tuple(_CameraRow.model_validate(row).posed(frame_id) for row in rows)
    except (ValidationError, FastSplatError, TypeError) as error:
        raise SceneFileError(f"cameras.json is malformed: {error}", field="cameras.json", hint=_RESTORE) from error


class _Encoder(_StrictRow):
    name: str
    sha256: str


def _sh_count(count: int) -> int:
    if count not in SH_COUNTS:
        raise ValueError(f"{count} harmonics, expected one of {SH_COUNTS}")
    return count


class _Sizes(_StrictRow):
    gaussians: Annotated[int, Field(ge=0)]
    sh: Annotated[int, AfterValidator(_sh_count)]
    code: Annotated[int, Field(ge=0)]
    embedding: Annotated[int, Field(ge=0)]


class _Evidence(_StrictRow):
    entries: Annotated[int, Field(ge=0)]
    sha256: str


class Manifest(_StrictRow):
    """Contents of `scene.json`; fields named as in `Scene` have the same meaning."""

    format: str
    schema_: int = Field(alias="schema")
    entries: tuple[DictionaryEntry, ...] = Field(alias="dictionary")
    text_encoder: _Encoder
    label_templates: tuple[str, ...]
    scale: Scale
    training: dict[str, Any]
    quality: dict[str, Any]
    sizes: _Sizes
    arrays_sha256: str
    evidence: _Evidence | None
    objects: _ObjectsRow | None
    cameras_sha256: str
    sha256: str  # of all else
    scaling: Scaling | None
    alignment: Alignment | None
    observations: Annotated[tuple[Observation, ...], PlainValidator(observations_from_json)]


_Row4 = Annotated[list[float], Field(min_length=4, max_length=4)]


class _CameraRow(_StrictRow):
    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_from_camera: Annotated[list[_Row4], Field(min_length=4, max_length=4)]

    def posed(self, frame_id: str) -> PosedCamera:
        camera = Camera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)
        return PosedCamera(camera, np.array(self.world_from_camera, dtype=np.float64), self.name, frame_id)


def _finite(value: Any, name: str, left_out: list[str]) -> Any:
    """Copies JSON values without non-finite numbers (None in sequences), whose names `left_out` gets."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        left_out.append(name)
        return None
    if isinstance(value, Mapping):
        parts = {key: _finite(part, f"{name}.{key}", left_out) for key, part in value.items()}
        return {key: part for key, part in parts.items() if part is not None or value[key] is None}
    if isinstance(value, (list, tuple)):
        return [_finite(part, f"{name}.{index}", left_out) for index, part in enumerate(value)]
    return value


def _seal(body: Mapping[str, Any]) -> str:
    """SHA-256 of the canonical JSON, which reformatting does not change."""
    return hashlib.sha256(json.dumps(body, sort_keys=True, allow_nan=False).encode()).hexdigest()


def _parse(data: bytes, name: str) -> Any:
    try:
        return json.loads(data.decode(), parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise SceneFileError(f"{name} is not whole JSON: {error}", field=name, hint=_RESTORE) from error


def _no_constant(text: str) -> float:
    raise ValueError(f"{text} is not JSON")
