"""Conversion of job options and cameras to and from JSON columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from fastsplat_contract.codec.json_codec import from_plain, to_plain
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.jobs.operations import SceneOptions


def options_to_json(options: SceneOptions) -> dict[str, Any]:
    values: dict[str, Any] = to_plain(options)
    return values


def options_from_json(row: Mapping[str, Any]) -> SceneOptions:
    """Inverts `options_to_json`; other keys are ignored."""
    return from_plain(
        SceneOptions, {field.name: row[field.name] for field in fields(SceneOptions) if field.name in row}
    )


def camera_to_json(posed: PosedCamera) -> dict[str, Any]:
    """Converts a posed camera: intrinsics in pixels, `world_from_camera` row by row."""
    return {"name": posed.name, **asdict(posed.camera), "world_from_camera": posed.world_from_camera.tolist()}


def camera_from_json(row: Mapping[str, Any]) -> PosedCamera:
    """Inverts `camera_to_json` exactly."""
    camera = Camera(row["width"], row["height"], row["fx"], row["fy"], row["cx"], row["cy"])
    return PosedCamera(camera, np.array(row["world_from_camera"], dtype=np.float64), row["name"])
