"""Questions about places and colors, over both protocols, in process, and as poses arrive."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat_client import Client
from fastsplat_contract.geometry.poses import pose_of
from fastsplat_contract.messages.queries import QueryRequest
from tests.api.clients import assert_same
from tests.api.made_scene import turned

_MUG, _BALL, _BOOK = 1, 2, 3
_FRONT = turned(0.0)


_BEHIND = pose_of(np.array([[-1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 8], [0, 0, 0, 1]]))
"""On the other side of the blobs, looking back."""


@pytest.mark.parametrize(
    ("text", "choices", "objects"),
    [
        ("the object left of the ball", {"asker_view": "front.png"}, (_MUG,)),
        ("the object left of the ball", {"asker": pose_of(_FRONT.world_from_camera)}, (_MUG,)),
        ("the object left of the ball", {"asker": _BEHIND}, (_BOOK,)),
        ("second object from the right", {"asker_view": "front.png"}, (_BALL,)),
        ("the red mug", {}, (_MUG,)),
        ("the blue mug", {}, ()),
        ("how many objects are red?", {}, (_MUG,)),
        ("the object left of the ball", {}, None),
        ("the mug on the piano", {}, None),
    ],
)
def test_every_face_answers_the_same(
    service: SceneService, client: Client, scene_id: str, text: str, choices: dict[str, Any], objects: tuple[int, ...]
) -> None:
    request = QueryRequest(scene_id, (text,), outputs=frozenset({"mask3d", "objects"}), **choices)
    truth = service.answers.query(request).answers
    assert_same(client.ask(request), truth)
    assert_same(client.ask(request, protocol="gRPC"), truth)
    (phrase,) = (answer.phrase for answer in truth)
    assert phrase is not None and (phrase.refusal is None) == (objects is not None)
    assert objects is None or truth[0].object_ids == phrase.object_ids == objects


def test_a_picture_shows_the_meant_object_as_seen_from_it(client: Client, scene_id: str) -> None:
    left, whole = (
        client.picture(scene_id, "mask", "front.png", text=text) for text in ("the object left of the ball", "mug")
    )
    assert left == whole
