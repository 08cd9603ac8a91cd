"""A thing gets a name by one click, and is asked for by that name."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from fastsplat_client import Client
from fastsplat_contract.queries import Answer
from fastsplat_contract.thing_messages import PickedThing

NAME = "Oskar"
"""A name that no detector knows."""


def click_and_name(client: Client, scene_id: str, answers: Sequence[Answer]) -> tuple[PickedThing, str] | None:
    """Click on the first thing that answers anything, where its view shows most of it, and name it `NAME`; returns what
    was under the click and the view, or None where nothing answers."""
    for answer in answers:
        for thing in answer.objects or ():
            for view in thing.best_views[:1]:
                (seen,) = client.query(scene_id, thing.label, views=[view], outputs=["mask2d"])
                inner = cv2.distanceTransform(seen.masks[0].array().astype(np.uint8), cv2.DIST_L2, 5)
                if inner.max() > 0:
                    row, column = np.unravel_index(int(inner.argmax()), inner.shape)
                    picked = client.pick(scene_id, view, pixel=(float(column) + 0.5, float(row) + 0.5))
                    client.name_things(scene_id, picked.thing.id, NAME, looked_at=picked.version)
                    return picked, view
    return None
