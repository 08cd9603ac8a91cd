"""Stored rows to what callers see."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from datetime import UTC, datetime
from typing import Any

from fastsplat.service.calls.types import (
    DictionaryRow,
    Operation,
    OperationError,
    SceneInfo,
    StageProgress,
)
from fastsplat.service.store.codec import camera_from_json
from fastsplat.service.store.records import OperationRecord, SceneRecord


def operation_of(record: OperationRecord) -> Operation:
    """What a caller sees of an operation row."""
    error = record.error
    return Operation(
        id=record.id,
        scene_id=record.scene_id,
        state=record.state,
        created_at=_time(record.created_at),
        updated_at=_time(record.updated_at),
        stages=tuple(StageProgress(**stage) for stage in record.stages),
        error=None if error is None else OperationError(**error),
    )


def scene_of(record: SceneRecord, max_listed: int | None = None) -> SceneInfo:
    """What a caller sees of a scene row, with at most `max_listed` of its labels and cameras."""
    return SceneInfo(
        id=record.id,
        name=record.name,
        state=record.state,
        operation_id=record.operation_id,
        created_at=_time(record.created_at),
        gaussians=record.gaussians,
        scale=record.scale,
        dictionary=tuple(label_of(row) for row in record.dictionary[:max_listed]),
        cameras=tuple(camera_from_json(row) for row in record.cameras[:max_listed]),
        quality=record.quality,
        version=record.version,
        label_count=len(record.dictionary),
        camera_count=len(record.cameras),
    )


def label_of(row: Mapping[str, Any]) -> DictionaryRow:
    """What a caller sees of a stored dictionary entry; a row may hold more than callers are shown."""
    shown = {field.name: row[field.name] for field in fields(DictionaryRow)}
    return DictionaryRow(**{**shown, "aliases": tuple(row["aliases"])})


def _time(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
