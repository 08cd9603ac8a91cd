"""Stores a scene's observations in the trained version's frame.

This keeps them valid when the scene is scaled or aligned to a map.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from fastsplat.service.common.similarity import Similarity
from fastsplat_contract.codec.json_codec import from_json, to_plain
from fastsplat_contract.geometry.poses import Box, Pose, Vector3, quaternion_of, vector3
from fastsplat_contract.photos.localization import SceneChange
from fastsplat_contract.photos.observations import Observation


def in_frame(observation: Observation, frame: Similarity) -> Observation:
    """Transforms an observation's cameras and boxes; sentences stay unchanged."""

    def placed(box: Box | None) -> Box | None:
        if box is None:
            return None
        pose = box.center.matrix()
        center = vector3(frame.points(pose[None, :3, 3])[0])
        turned = quaternion_of(frame.rotation @ pose[:3, :3])
        return Box(Pose(center, turned), Vector3(*(float(side) * frame.scale for side in box.size)))

    def moved(change: SceneChange) -> SceneChange:
        distance = change.distance * frame.scale
        return change._replace(distance=distance, before=placed(change.before), after=placed(change.after))

    photos = tuple(photo._replace(camera=frame.camera(photo.camera)) for photo in observation.photos)
    return replace(observation, photos=photos, changes=tuple(map(moved, observation.changes)))


def observations_to_json(observations: Sequence[Observation]) -> list[dict[str, Any]]:
    """Converts observations to JSON values."""
    return [to_plain(observation) for observation in observations]


def observations_from_json(rows: Sequence[Mapping[str, Any]]) -> tuple[Observation, ...]:
    """Reads the output of `observations_to_json`.

    Raises:
        InvalidInputError: malformed rows.
    """
    return tuple(from_json(Observation, json.dumps(row)) for row in rows)
