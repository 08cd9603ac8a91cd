"""Observations of a scene as its folder keeps them: in the frame of the trained version, so that they stay true when
the scene is scaled or put into a map."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from fastsplat.service.common.similarity import Similarity
from fastsplat_contract.json_codec import from_json, to_plain
from fastsplat_contract.observation_messages import Observation
from fastsplat_contract.poses import Box, Pose, Vector3, quaternion_of, vector3


def in_frame(observation: Observation, frame: Similarity) -> Observation:
    """The same observation in another frame; sentences stay as they are.

    Args:
        observation: cameras and boxes in one frame.
        frame: from that one into the other.
    """

    def placed(box: Box | None) -> Box | None:
        if box is None:
            return None
        pose = box.center.matrix()
        center = vector3(frame.points(pose[None, :3, 3])[0])
        turned = quaternion_of(frame.rotation @ pose[:3, :3])
        return Box(Pose(center, turned), Vector3(*(float(side) * frame.scale for side in box.size)))

    return replace(
        observation,
        photos=tuple(photo._replace(camera=frame.camera(photo.camera)) for photo in observation.photos),
        changes=tuple(
            each._replace(distance=each.distance * frame.scale, before=placed(each.before), after=placed(each.after))
            for each in observation.changes
        ),
    )


def observations_to_json(observations: Sequence[Observation]) -> list[dict[str, Any]]:
    """Observations as plain values."""
    return [to_plain(each) for each in observations]


def observations_from_json(rows: Sequence[Mapping[str, Any]]) -> tuple[Observation, ...]:
    """What `observations_to_json` wrote.

    Raises:
        InvalidInputError: it wrote something else.
    """
    return tuple(from_json(Observation, json.dumps(row)) for row in rows)
