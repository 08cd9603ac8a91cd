"""Observations follow their scene into another frame."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from fastsplat.service.common.similarity import Similarity
from fastsplat.service.scene.artefact.observations import in_frame
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.photos.localization import SceneChange
from fastsplat_contract.photos.observations import Observation

_QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_BEFORE = Box(Pose(Vector3(1.0, 2.0, 0.5), Quaternion(0.0, 0.0, 0.0, 1.0)), Vector3(0.1, 0.2, 0.3))
OBSERVATION = Observation(
    "s",
    "e",
    datetime(2026, 11, 24, tzinfo=UTC),
    "given",
    (),
    (),
    (SceneChange("moved", 1, "mug", 0.9, 0.4, _BEFORE, None, (0,), ""),),
    (1,),
    True,
    "",
)


def test_lengths_grow_and_places_follow() -> None:
    frame = Similarity(2.0, _QUARTER_TURN, np.array([10.0, 0.0, 0.0]))
    (change,) = in_frame(OBSERVATION, frame).changes
    assert change.distance == 0.8 and change.after is None and change.before is not None
    np.testing.assert_allclose(change.before.size, (0.2, 0.4, 0.6))
    np.testing.assert_allclose(change.before.center.position, frame.points(np.array([[1.0, 2.0, 0.5]]))[0])
    np.testing.assert_allclose(change.before.center.matrix()[:3, :3], _QUARTER_TURN, atol=1e-12)
