"""Everything that a scene holds, named or not; and a thing that gets a name by one click."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat_client import Client
from fastsplat_contract.messages.things import PickedThing, SceneThing

NAME = "Oskar"
"""A name that no detector knows."""


def click_and_name(client: Client, scene_id: str, view: str) -> PickedThing | None:
    """Click on a thing of a view and name it `NAME`, see `thing_to_name`; returns what was under the click, None for a
    view without things."""
    ids = client.thing_map(scene_id, view)
    things = {thing.id: thing for thing in client.things(scene_id)}
    target = thing_to_name(ids, things)
    if target is None:
        return None
    inner = cv2.distanceTransform((ids == target).astype(np.uint8), cv2.DIST_L2, 5)
    row, column = np.unravel_index(int(inner.argmax()), inner.shape)
    picked = client.pick(scene_id, view, pixel=(float(column) + 0.5, float(row) + 0.5))
    client.name_things(scene_id, picked.thing.id, NAME, looked_at=picked.version)
    return picked


def thing_to_name(ids: NDArray[np.uint16], things: Mapping[int, SceneThing]) -> int | None:
    """Id of the thing that a click on a view names; None where the view shows no thing.

    Things without a name come before named ones, surfaces last; then what the picture shows whole before what its edge
    cuts off, then the largest.

    Args:
        ids: uint16 [H, W], the thing of each pixel, 0 for none.
        things: by id.
    """
    numbers, areas = np.unique(ids[ids > 0], return_counts=True)
    shown = [(things[number], area) for number, area in zip(numbers.tolist(), areas.tolist(), strict=True)]
    cut = set(np.concatenate([ids[0], ids[-1], ids[:, 0], ids[:, -1]]).tolist()) if ids.size else set()
    order = sorted(shown, key=lambda one: (one[0].kind == "surface", bool(one[0].name), one[0].id in cut, -one[1]))
    return order[0][0].id if order else None
