"""Stored rows to what callers see, and a finished scene to what is stored."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from fastsplat.service.store.records import OperationRecord, SceneRecord
from fastsplat_contract.camera import Camera, PosedCamera
from fastsplat_contract.json_codec import from_plain, to_plain
from fastsplat_contract.operations import FINAL_STATES, Operation, OperationError, SceneOptions, StageProgress
from fastsplat_contract.scenes import DictionaryEntry, Scene, SceneSummary

_ADMITTED = "admitted"


def operation_of(record: OperationRecord) -> Operation:
    """What a caller sees of an operation row; a metric that is no finite number is left out."""
    error = record.error
    return Operation(
        id=record.id,
        scene_id=record.scene_id,
        state=record.state,
        done=record.state in FINAL_STATES,
        created_at=_time(record.created_at),
        updated_at=_time(record.updated_at),
        stages=tuple(_stage_of(stage) for stage in record.stages),
        error=None if error is None else OperationError(**error),
    )


def summary_of(record: SceneRecord) -> SceneSummary:
    """What a list shows of a scene row."""
    return SceneSummary(
        id=record.id,
        name=record.name,
        state=record.state,
        operation_id=record.operation_id,
        created_at=_time(record.created_at),
        gaussians=record.gaussians,
        scale=record.scale,
        version=record.version,
        label_count=len(record.dictionary),
    )


def scene_of(record: SceneRecord, max_listed: int | None = None) -> Scene:
    """What a caller sees of a scene row, with at most `max_listed` of its labels and cameras."""
    return Scene(
        **vars(summary_of(record)),
        camera_count=len(record.cameras),
        dictionary=tuple(label_of(row) for row in record.dictionary[:max_listed]),
        cameras=tuple(camera_from_json(row) for row in record.cameras[:max_listed]),
        quality=record.quality,
    )


def stored_options(options: SceneOptions, admitted: str) -> dict[str, Any]:
    """The user's choices as they are stored with an operation, and the folder of the admitted upload."""
    return {_ADMITTED: admitted, **to_plain(options)}


def options_of(record: OperationRecord) -> SceneOptions:
    """Back from `stored_options`; an operation of the first releases lacks what came later."""
    plain = {name: value for name, value in record.options.items() if name != _ADMITTED}
    return replace(from_plain(SceneOptions, plain), priority=record.priority)


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


def label_of(row: Mapping[str, Any]) -> DictionaryEntry:
    """What a caller sees of a stored dictionary entry."""
    return DictionaryEntry(**{**row, "aliases": tuple(row["aliases"])})


def _stage_of(row: Mapping[str, Any]) -> StageProgress:
    metrics = {name: value for name, value in row["metrics"].items() if math.isfinite(value)}
    return StageProgress(**{**row, "metrics": metrics})


def _time(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
