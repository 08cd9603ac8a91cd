"""Contents of a scene's recording for robotics viewers (Foxglove, Rerun)."""

from __future__ import annotations

import colorsys
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fastsplat.service.query.surfaces.occupancy import OccupancyMap
from fastsplat.service.scene.artefact.scaling import capture_scaling
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.messages.objects import SceneObject

MOST_PHOTO_BYTES = 64 << 20
"""Limit of all photos in a file; beyond it, photos are skipped evenly."""

_HUE_STEP = 0.618034


@dataclass(frozen=True)
class SceneRecording:
    """Contents of a recording beside the scene's index.

    Attributes:
        created_ns: creation time of the version, nanoseconds since 1970.
        points: a file of `point_ply`.
        photos: JPEG files, by camera number.
        photos_left_out: number of kept photos not included.
        floor_missing: reason if there is no `floor` map.
    """

    scene_id: str
    version: str
    name: str
    created_ns: int
    points: bytes
    photos: Mapping[int, bytes]
    photos_left_out: int = 0
    floor: OccupancyMap | None = None
    floor_missing: str = ""


def bounded_photos(sizes: Mapping[int, int], most: int = MOST_PHOTO_BYTES) -> list[int]:
    """Every n-th photo, with the least n for which they fit into `most` bytes; `sizes` are by camera number."""
    numbers = sorted(sizes)
    for step in range(1, len(numbers) + 1):
        if sum(sizes[number] for number in numbers[::step]) <= most:
            return numbers[::step]
    return []


def described(scene: Scene, recording: SceneRecording, listed: Sequence[SceneObject]) -> dict[str, str]:
    """Metadata of a recording, with a warning where lengths are not meters."""
    scaling, metric = scene.scaling or capture_scaling(scene.facts), scene.scale == "METRIC"
    up = scene.up()
    lines = {
        "scene_id": recording.scene_id,
        "version": recording.version,
        "name": recording.name,
        "frame_id": scene.frame_id,
        "scale": scene.scale,
        "unit": "metre" if metric else "arbitrary",
        "up": "unknown" if up is None else json.dumps(up.tolist()),
        "objects": str(len(listed)),
        "objects_without_box": json.dumps([obj.id for obj in listed if obj.box is None]),
        "cameras": str(len(scene.cameras)),
        "photos": str(len(recording.photos)),
        "photos_left_out": str(recording.photos_left_out),
    }
    if recording.floor_missing:
        lines["no_map"] = recording.floor_missing
    if not metric:
        lines["warning"] = "Lengths are not meters, though viewers show them as such: the scene's scale is arbitrary."
    elif scaling is not None:
        lines["meters_per_unit"] = repr(float(scaling.meters_per_unit))
        lines["meters_per_unit_95"] = json.dumps([float(scaling.low), float(scaling.high)])
    return lines


def object_facts(obj: SceneObject) -> dict[str, str]:
    """Metadata of an object beside its box."""
    return {
        "name": obj.name,
        "source": obj.source or "",
        "probability": repr(float(obj.probability)),
        "suggestions": json.dumps({suggestion.name: float(suggestion.probability) for suggestion in obj.suggestions}),
        "kind": obj.kind,
        "surface": obj.surface,
        "gaussians": str(obj.gaussian_count),
        "meters": json.dumps(obj.meters),
    }


def object_color(object_id: int) -> tuple[float, float, float]:
    """RGB from 0 to 1; neighboring ids differ clearly."""
    return colorsys.hsv_to_rgb(object_id * _HUE_STEP % 1.0, 0.7, 1.0)
