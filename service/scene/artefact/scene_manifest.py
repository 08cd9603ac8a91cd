"""Encodes and validates `scene.json` and `cameras.json`."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.scene.artefact.alignment import Alignment, alignment_from_json, alignment_to_json
from fastsplat.service.scene.artefact.observations import observations_from_json, observations_to_json
from fastsplat.service.scene.artefact.reads import MAX_READ_CHARS, MOST_READS
from fastsplat.service.scene.artefact.scaling import Scaling, scaling_from_json, scaling_to_json
from fastsplat.service.scene.artefact.scene import SH_COUNTS, Looks, NameSource, Object, ObjectGroup, SurfaceKind
from fastsplat.service.scene.artefact.scene_facts import SceneFacts, split_quality
from fastsplat.service.scene.artefact.suggestions import Suggestion
from fastsplat_contract.errors import FastSplatError, InvalidInputError, SceneFileError, SceneSchemaError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.messages.object_reads import ObjectRead, ReadKind
from fastsplat_contract.messages.scenes import Scale
from fastsplat_contract.photos.observations import Observation

_Share = Annotated[float, Field(ge=0, le=1)]
_Words = Annotated[tuple[str, ...], Field(strict=False)]
_Pair = Annotated[tuple[str, _Share], Field(strict=False)]
_FullSuggestion = Annotated[tuple[str, _Share, str, str, _Words], Field(strict=False)]
_Suggestion = _Pair | _FullSuggestion
"""The source is omitted for suggestions of the scene's own models."""

_Line = Annotated[str, Field(min_length=1, max_length=MAX_READ_CHARS)]
_Read = Annotated[tuple[ReadKind, _Line, _Share, Annotated[int, Field(ge=1)]], Field(strict=False)]
_Cameras = Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(strict=False)]

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


class _ObjectRow(_StrictRow):
    """An object, or a part of one."""

    id: Annotated[int, Field(ge=1, le=65535)]
    name: str
    source: NameSource | None
    probability: _Share
    consensus: _Share
    surface: SurfaceKind
    suggestions: Annotated[tuple[_Suggestion, ...], Field(strict=False)]
    parent: Annotated[int, Field(ge=0, le=65535)]
    appearance: _Base64 = ""
    picture: _Base64 = ""
    proposed_in: _Cameras = ()
    missed_in: _Cameras = ()
    reads: Annotated[tuple[_Read, ...], Field(strict=False, max_length=MOST_READS)] = ()
    looks: Annotated[tuple[str, _Base64], Field(strict=False)] | None = None

    @model_validator(mode="after")
    def _names_have_a_source(self) -> _ObjectRow:
        if bool(self.name) != (self.source is not None):
            raise ValueError(f"the object {self.id} has a name without a source, or the other way round")
        return self


class _GroupRow(_StrictRow):
    """A group of objects."""

    id: Annotated[int, Field(ge=1, le=65535)]
    members: Annotated[tuple[int, ...], Field(strict=False, min_length=2)]
    consensus: _Share


class _Parts(_StrictRow):
    table: list[_ObjectRow]
    entries: Annotated[int, Field(ge=0)]
    sha256: str


class _ObjectsRow(_StrictRow):
    """Objects of a scene with their parts and groups."""

    table: list[_ObjectRow]
    next_id: Annotated[int, Field(ge=0, le=65536)]
    entries: Annotated[int, Field(ge=0)]
    sha256: str
    classes: Annotated[int, Field(ge=1)] | None
    parts: _Parts | None
    groups: list[_GroupRow]

    @model_validator(mode="after")
    def _ids_ascend(self) -> _ObjectsRow:
        ids = [obj.id for obj in self.table]
        if ids != sorted(set(ids)):
            raise ValueError("the objects' ids do not ascend")
        return self

    @model_validator(mode="after")
    def _parts_are_of_objects(self) -> _ObjectsRow:
        object_ids = [obj.id for obj in self.table]
        parts = [] if self.parts is None else self.parts.table
        ids = [part.id for part in parts]
        if ids != sorted(set(ids)) or set(ids) & set(object_ids):
            raise ValueError("the parts' ids do not ascend, or are those of objects")
        if any(obj.parent for obj in self.table) or not {part.parent for part in parts} <= set(object_ids):
            raise ValueError("a part is of no object, or an object of another")
        return self

    @model_validator(mode="after")
    def _groups_are_of_objects(self) -> _ObjectsRow:
        object_ids = {obj.id for obj in self.table}
        parts = set() if self.parts is None else {part.id for part in self.parts.table}
        ids = [group.id for group in self.groups]
        if ids != sorted(set(ids)) or set(ids) & (object_ids | parts):
            raise ValueError("the groups' ids do not ascend, or are those of objects or parts")
        for group in self.groups:
            if list(group.members) != sorted(set(group.members)) or not set(group.members) <= object_ids:
                raise ValueError(f"the members of group {group.id} do not ascend, or are no objects")
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


def _object_of_row(row: _ObjectRow) -> Object:
    """Decodes the output of `_object_row`."""
    decoded = {name: base64.b64decode(getattr(row, name)) for name in ("appearance", "picture")}
    suggestions = tuple(Suggestion(*values) for values in row.suggestions)
    reads = tuple(ObjectRead(*values) for values in row.reads)
    looks = None if row.looks is None else Looks(row.looks[0], base64.b64decode(row.looks[1]))
    return Object(**{**vars(row), **decoded, "suggestions": suggestions, "reads": reads, "looks": looks})


@dataclass(frozen=True)
class Manifest:
    """Contents of `scene.json`; fields named as in `Scene` have the same meaning."""

    dictionary: Dictionary
    text_encoder: tuple[str, str]
    label_templates: tuple[str, ...]
    scale: Scale
    training: Mapping[str, Any]
    quality: Mapping[str, Any]
    facts: SceneFacts
    gaussians: int  # G
    sh: int  # K
    code: int  # D
    embedding: int  # E
    arrays_sha256: str  # digest, also of the row order
    evidence_entries: int | None = None  # M; None without evidence
    evidence_sha256: str = ""
    objects: tuple[Object, ...] | None = None  # table; None for a scene without
    objects_entries: int = 0  # M of the membership
    objects_sha256: str = ""  # of membership and head
    objects_classes: int | None = None  # C of the head; None for objects without codes
    next_object_id: int = 0
    parts: tuple[Object, ...] | None = None  # table; None for objects without
    parts_entries: int = 0
    parts_sha256: str = ""
    groups: tuple[ObjectGroup, ...] = ()
    scaling: Scaling | None = None
    alignment: Alignment | None = None
    observations: tuple[Observation, ...] = ()


def manifest_to_bytes(manifest: Manifest, cameras: bytes) -> bytes:
    """Encodes `scene.json`, with digests of itself and of `cameras.json`.

    Non-finite numbers of training and quality are dropped rather than failing the scene; quality lists them as
    `left_out`.

    Raises:
        InvalidInputError: training or quality holds values that are not JSON.
    """
    left_out: list[str] = []
    training = _finite(manifest.training, "training", left_out)
    quality = _finite(manifest.facts.with_quality(manifest.quality), "quality", left_out)
    if left_out:
        quality["left_out"] = sorted(left_out)
    body: dict[str, Any] = {
        "format": _FORMAT,
        "schema": SCHEMA,
        "dictionary": [asdict(entry) for entry in manifest.dictionary.entries],
        "text_encoder": {"name": manifest.text_encoder[0], "sha256": manifest.text_encoder[1]},
        "label_templates": list(manifest.label_templates),
        "scale": manifest.scale,
        "scaling": scaling_to_json(manifest.scaling),
        "alignment": alignment_to_json(manifest.alignment),
        "observations": observations_to_json(manifest.observations),
        "training": training,
        "quality": quality,
        "sizes": {
            "gaussians": manifest.gaussians,
            "sh": manifest.sh,
            "code": manifest.code,
            "embedding": manifest.embedding,
        },
        "arrays_sha256": manifest.arrays_sha256,
        "evidence": None
        if manifest.evidence_entries is None
        else {"entries": manifest.evidence_entries, "sha256": manifest.evidence_sha256},
        "objects": None
        if manifest.objects is None
        else {
            "table": [_object_row(obj) for obj in manifest.objects],
            "next_id": manifest.next_object_id,
            "entries": manifest.objects_entries,
            "sha256": manifest.objects_sha256,
            "classes": manifest.objects_classes,
            "parts": None
            if manifest.parts is None
            else {
                "table": [_object_row(part) for part in manifest.parts],
                "entries": manifest.parts_entries,
                "sha256": manifest.parts_sha256,
            },
            "groups": [asdict(group) for group in manifest.groups],
        },
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
    seal = body.pop("sha256", None)
    if seal != _seal(body):
        raise SceneFileError("scene.json does not match its own digest", field="scene.json", hint=_RESTORE)
    try:
        checked = _Body.model_validate(body)
        dictionary = Dictionary(tuple(DictionaryEntry(**entry.model_dump()) for entry in checked.dictionary))
        observations = observations_from_json(checked.observations)
    except (ValidationError, FastSplatError) as error:
        raise SceneFileError(f"scene.json is malformed: {error}", field="scene.json", hint=_RESTORE) from error
    if checked.cameras_sha256 != hashlib.sha256(cameras).hexdigest():
        raise SceneFileError("cameras.json does not match its digest", field="cameras.json", hint=_RESTORE)
    parts = None if checked.objects is None else checked.objects.parts
    facts, quality = split_quality(checked.quality)
    return Manifest(
        dictionary=dictionary,
        text_encoder=(checked.text_encoder.name, checked.text_encoder.sha256),
        label_templates=tuple(checked.label_templates),
        scale=checked.scale,
        training=checked.training,
        quality=quality,
        facts=facts,
        gaussians=checked.sizes.gaussians,
        sh=checked.sizes.sh,
        code=checked.sizes.code,
        embedding=checked.sizes.embedding,
        arrays_sha256=checked.arrays_sha256,
        evidence_entries=None if checked.evidence is None else checked.evidence.entries,
        evidence_sha256="" if checked.evidence is None else checked.evidence.sha256,
        objects=None if checked.objects is None else tuple(_object_of_row(row) for row in checked.objects.table),
        objects_entries=0 if checked.objects is None else checked.objects.entries,
        objects_sha256="" if checked.objects is None else checked.objects.sha256,
        objects_classes=None if checked.objects is None else checked.objects.classes,
        next_object_id=0 if checked.objects is None else checked.objects.next_id,
        parts=None if parts is None else tuple(_object_of_row(row) for row in parts.table),
        parts_entries=0 if parts is None else parts.entries,
        parts_sha256="" if parts is None else parts.sha256,
        groups=()
        if checked.objects is None
        else tuple(ObjectGroup(row.id, row.members, row.consensus) for row in checked.objects.groups),
        scaling=scaling_from_json(None if checked.scaling is None else checked.scaling.model_dump()),
        alignment=alignment_from_json(None if checked.alignment is None else checked.alignment.model_dump()),
        observations=observations,
    )


def cameras_to_bytes(cameras: Sequence[PosedCamera]) -> bytes:
    """Encodes `cameras.json`: name, intrinsics in pixels, world_from_camera (row-major, scene units)."""
    rows = [
        {
            "name": posed.name,
            **asdict(posed.camera),
            "world_from_camera": np.asarray(posed.world_from_camera, dtype=np.float64).tolist(),
        }
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
        checked = [_CameraRow.model_validate(row) for row in rows]
        return tuple(
            PosedCamera(
                Camera(row.width, row.height, row.fx, row.fy, row.cx, row.cy),
                np.array(row.world_from_camera, dtype=np.float64),
                row.name,
                frame_id,
            )
            for row in checked
        )
    except (ValidationError, FastSplatError, TypeError) as error:
        raise SceneFileError(f"cameras.json is malformed: {error}", field="cameras.json", hint=_RESTORE) from error


class _Entry(_StrictRow):
    label: str
    aliases: Annotated[tuple[str, ...], Field(strict=False)]
    pixels: int
    views: int
    confidence: Annotated[float, Field(ge=0, le=1)]


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


_Positive = Annotated[float, Field(gt=0)]
_Deviation = Annotated[float, Field(ge=0)]


class _Length(_StrictRow):
    units: _Positive
    deviation: _Deviation
    meters: _Positive
    meters_deviation: _Deviation


class _Scaling(_StrictRow):
    meters_per_unit: _Positive
    low: _Positive
    high: _Positive
    lengths: list[_Length]


_Row3 = Annotated[list[float], Field(min_length=3, max_length=3)]


class _Alignment(_StrictRow):
    frame: str
    rotation: Annotated[list[_Row3], Field(min_length=3, max_length=3)]
    translation: _Row3
    pairs: Annotated[int, Field(ge=0)]
    residuals: list[float]
    rms: float | None
    outliers: list[int]
    scaled: bool


class _Body(_StrictRow):
    format: str
    schema_: int = Field(alias="schema")
    dictionary: list[_Entry]
    text_encoder: _Encoder
    label_templates: list[str]
    scale: Scale
    training: dict[str, Any]
    quality: dict[str, Any]
    sizes: _Sizes
    arrays_sha256: str
    evidence: _Evidence | None
    objects: _ObjectsRow | None
    cameras_sha256: str
    scaling: _Scaling | None
    alignment: _Alignment | None
    observations: list[dict[str, Any]]


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


def _finite(value: Any, name: str, left_out: list[str]) -> Any:
    """Copies JSON values with Python numbers, without non-finite ones (None in sequences).

    Appends the dotted names of dropped numbers to `left_out`.
    """
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
