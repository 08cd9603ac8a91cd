"""Stored rows to what callers see, and a finished scene to what is stored."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from datetime import UTC, datetime
from typing import Any

import numpy as np

from fastsplat.service.calls.types import (
    DictionaryRow,
    Operation,
    OperationError,
    SceneInfo,
    SceneOptions,
    StageProgress,
)
from fastsplat.service.common.camera import Camera, PosedCamera
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


def options_of(options: Mapping[str, Any]) -> SceneOptions:
    """The user's choices as stored with an operation."""
    return SceneOptions(
        labels=tuple(options["labels"]),
        time_budget_s=options["time_budget_s"],
        max_gaussians=options["max_gaussians"],
        preset=options.get("preset"),
    )


def camera_to_json(posed: PosedCamera) -> dict[str, Any]:
    """A posed camera as JSON numbers: intrinsics in pixels, `world_from_camera` row by row."""
    camera = posed.camera
    return {
        "name": posed.name,
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "world_from_camera": posed.world_from_camera.tolist(),
    }


def camera_from_json(row: Mapping[str, Any]) -> PosedCamera:
    """Back from `camera_to_json`, exactly."""
    camera = Camera(row["width"], row["height"], row["fx"], row["fy"], row["cx"], row["cy"])
    return PosedCamera(camera, np.array(row["world_from_camera"], dtype=np.float64), row["name"])


def label_of(row: Mapping[str, Any]) -> DictionaryRow:
    """What a caller sees of a stored dictionary entry; a row may hold more than callers are shown."""
    shown = {field.name: row[field.name] for field in fields(DictionaryRow)}
    return DictionaryRow(**{**shown, "aliases": tuple(row["aliases"])})


def _time(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
