"""Conversion of database rows to contract messages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from datetime import UTC, datetime
from itertools import islice
from typing import Any

import numpy as np

from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.capture.uploads.photo_exclusion import ON_REQUEST
from fastsplat.service.scene.artefact.alignment import alignment_from_json, frame_similarity
from fastsplat.service.scene.artefact.assessment import assess
from fastsplat.service.scene.artefact.scaling import capture_scale_source, capture_scaling, scaling_from_json
from fastsplat.service.scene.artefact.scene_facts import SceneFacts, split_quality
from fastsplat.service.scene.artefact.upright import vertical_of
from fastsplat.service.store.rows.codec import camera_from_json
from fastsplat.service.store.rows.damaged_rows import decodes
from fastsplat.service.store.rows.records import SECONDS_LEFT, OperationRecord, SceneRecord
from fastsplat_contract.codec.json_codec import from_plain
from fastsplat_contract.geometry.poses import Pose, Vector3, quaternion_of
from fastsplat_contract.jobs.job_watching import DraftInfo, PlacedInfo, PreviewInfo, WorkerState
from fastsplat_contract.jobs.operations import FINAL_STATES, RESULTS, Operation, OperationError, StageProgress
from fastsplat_contract.messages.scenes import (
    DictionaryEntry,
    ScaleSource,
    Scene,
    SceneAlignment,
    SceneScaling,
    SceneSummary,
)

_LEFT_OUT = "left_out"
_MAX_LEFT_OUT = 100
_SOON_S = 10.0

Ahead = tuple[int, float]
"""Jobs ahead of a waiting one, and seconds until a worker is free (infinite: unknown)."""


def left_out_to_json(upload: ValidatedUpload) -> dict[str, Any]:
    """Unusable files of an upload, stored with the job's options for `operation_of`."""
    return {_LEFT_OUT: dict(islice(upload.left_out.items(), _MAX_LEFT_OUT))}


@decodes("operation")
def operation_of(record: OperationRecord, worker: WorkerState | None = None, ahead: Ahead | None = None) -> Operation:
    """Converts an operation row, without non-finite metrics; `worker` is None when done."""
    jobs_ahead, starts_in_s = (None, math.inf) if ahead is None else ahead
    error, done = record.error, record.state in FINAL_STATES
    files = {} if done or record.progress_files is None else record.progress_files
    left = record.stages[-1]["metrics"].get(SECONDS_LEFT) if record.stages and worker == "working" else None
    result: dict[str, Any] = (
        {} if record.result is None else {record.kind: from_plain(RESULTS[record.kind], dict(record.result))}
    )
    return Operation(
        id=record.id,
        scene_id=record.scene_id,
        state=record.state,
        done=done,
        created_at=_time(record.created_at),
        updated_at=_time(record.updated_at),
        stages=tuple(_stage_of(stage) for stage in record.stages),
        error=None if error is None else OperationError(**{**error, "photos": tuple(error.get("photos", ()))}),
        kind=record.kind,
        attempt=record.attempt,
        worker=worker,
        seconds_left=left if left is not None and 0 <= left < math.inf else None,
        jobs_ahead=jobs_ahead,
        starts_in_s=_SOON_S * round(starts_in_s / _SOON_S) if math.isfinite(starts_in_s) else None,
        finish_requested=record.finish_requested,
        preview=PreviewInfo(**files["preview"]["info"]) if "preview" in files else None,
        draft=DraftInfo(**files["draft"]["info"]) if "draft" in files else None,
        placed=PlacedInfo(**files["placed"]["info"]) if "placed" in files else None,
        again_after=record.again_after,
        left_out={**record.options.get(_LEFT_OUT, {}), **dict.fromkeys(record.excluded, ON_REQUEST)},
        **result,
    )


@decodes("scene")
def summary_of(record: SceneRecord) -> SceneSummary:
    """Converts a scene row for lists."""
    return SceneSummary(
        id=record.id,
        name=record.name,
        state=record.state,
        operation_id=record.operation_id,
        created_at=_time(record.created_at),
        gaussians=record.gaussians,
        scale=record.scale if record.scaling is None else "METRIC",
        version=record.version,
        label_count=len(record.dictionary),
        object_count=record.objects if record.version else None,
        captured_at=split_quality(record.quality)[0].newest_photo_at,
    )


@decodes("scene")
def scene_of(record: SceneRecord, max_listed: int | None = None) -> Scene:
    """Converts a scene row, with at most `max_listed` labels and cameras."""
    unit = None if record.scaling is None else record.scaling["meters_per_unit"]
    alignment = alignment_from_json(record.alignment)
    frame = frame_similarity(unit, alignment)  # rows are in the trained version's frame
    cameras = tuple(frame.camera(camera_from_json(row)) for row in record.cameras[:max_listed])
    facts, measured = split_quality(record.quality)
    return Scene(
        **vars(summary_of(record)),
        camera_count=len(record.cameras),
        dictionary=tuple(label_of(row) for row in record.dictionary[:max_listed]),
        cameras=cameras,
        quality=record.quality,
        assessment=assess(measured, facts, cameras) if record.state == "READY" else None,
        scaling=_scaling_of(record, facts),
        vertical=vertical_of(facts, alignment, cameras),
        alignment=_alignment_of(record),
        provisional=facts.draft,
    )


def _scaling_of(record: SceneRecord, facts: SceneFacts) -> SceneScaling | None:
    measured, scaling = capture_scaling(facts), scaling_from_json(record.scaling)
    if scaling is None:
        measured_by = capture_scale_source(facts)
        return None if measured is None else SceneScaling(measured_by, 1.0, measured.low, measured.high, 0)
    alignment = alignment_from_json(record.alignment)
    by_pairs = alignment is not None and alignment.scaled
    count = len(scaling.lengths) - (measured is not None) - by_pairs
    source: ScaleSource = "known_length" if count else "point_pairs"
    return SceneScaling(source, scaling.meters_per_unit, scaling.low, scaling.high, count)


def _alignment_of(record: SceneRecord) -> SceneAlignment | None:
    alignment = alignment_from_json(record.alignment)
    if alignment is None:
        return None
    pose = Pose(Vector3(*alignment.translation), quaternion_of(np.array(alignment.rotation)))
    residuals, outliers = alignment.residuals, alignment.outliers
    return SceneAlignment(alignment.frame, alignment.pairs, alignment.rms, residuals, outliers, pose)


@decodes("scene")
def labels_of(record: SceneRecord, rows: Sequence[Mapping[str, Any]]) -> tuple[DictionaryEntry, ...]:
    """Converts some dictionary rows of a scene."""
    return tuple(label_of(row) for row in rows)


def label_of(row: Mapping[str, Any]) -> DictionaryEntry:
    """Converts a dictionary row, dropping columns that are not shown."""
    columns = {field.name: row[field.name] for field in fields(DictionaryEntry)}
    return DictionaryEntry(**{**columns, "aliases": tuple(row["aliases"])})


def _stage_of(row: Mapping[str, Any]) -> StageProgress:
    metrics = {name: value for name, value in row["metrics"].items() if math.isfinite(value) and name != SECONDS_LEFT}
    columns = {field.name: row[field.name] for field in fields(StageProgress)}
    return StageProgress(**{**columns, "metrics": metrics})


def _time(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
