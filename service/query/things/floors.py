"""Floor detection by names and by height below the cameras, to exclude table tops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.scene.artefact.scene import Scene, Thing
from fastsplat_contract.geometry.camera import PosedCamera

_FLOORS = frozenset(
    "floor flooring floorboard floorboards ground carpet carpeting rug parquet linoleum laminate pavement paving "
    "sidewalk driveway patio lawn grass road street asphalt".split()
)
"""Last words of names of floors."""
_COVERINGS = frozenset("tile tiles tiling board boards covering mat".split())
"""Words that name a floor after "floor" or "ground"."""
_TRUSTED = ("given", "person")
"""Sources of names that are trusted at any height."""

LEAST_BELOW = 0.6
"""Least meters from a floor up to three of four cameras."""


def names_a_floor(names: Sequence[str]) -> bool:
    """True if one of these names (or aliases) is a floor's."""
    for name in names:
        words = name.casefold().replace("-", " ").split()
        covering = len(words) > 1 and words[-1] in _COVERINGS and words[-2] in ("floor", "ground")
        if words and (words[-1] in _FLOORS or covering):
            return True
    return False


def meters_below(cameras: Sequence[PosedCamera], up: NDArray[np.float64], height: float) -> float:
    """Distance that three of four cameras are above a height, at least."""
    heights = np.array([posed.world_from_camera[:3, 3] @ up for posed in cameras])
    return float(np.quantile(heights, 0.25)) - height


def with_floors_judged(scene: Scene, things: Sequence[Thing], owner: NDArray[np.int32]) -> tuple[Thing, ...]:
    """Re-judges level surfaces as floors by current names and scale.

    Discovery takes the lowest level surface below the cameras for the floor, before names and often before scale are
    known. A surface with another name is no floor; nor, in a metric scene, one less than `LEAST_BELOW` below the
    cameras, unless a person or the upload calls it a floor. A level surface named as a floor is one."""
    return tuple(_judged(scene, thing, owner) for thing in things)


def _judged(scene: Scene, thing: Thing, owner: NDArray[np.int32]) -> Thing:
    if thing.surface not in ("floor", "horizontal surface"):
        return thing
    named = names_a_floor(all_names(thing, scene.dictionary))
    is_floor = named if thing.name else thing.surface == "floor"
    if is_floor and not (named and thing.source in _TRUSTED):
        is_floor = not _near_the_cameras(scene, np.flatnonzero(owner == thing.id))
    return replace(thing, surface="floor" if is_floor else "horizontal surface")


def _near_the_cameras(scene: Scene, rows: NDArray[np.intp]) -> bool:
    up = scene.up()
    if scene.scale != "METRIC" or up is None or not scene.cameras or not len(rows):
        return False
    height = float(np.median(scene.gaussians.means[rows].astype(np.float64) @ up))
    return meters_below(scene.cameras, up, height) < LEAST_BELOW


def floor_ids(things: Sequence[Thing], dictionary: Dictionary) -> list[int]:
    """Ids of floors: judged level surfaces, or unclassified things with trusted floor names."""
    return [
        thing.id
        for thing in things
        if thing.surface == "floor"
        or (not thing.surface and thing.source in _TRUSTED and names_a_floor(all_names(thing, dictionary)))
    ]


def names_of_others(things: Sequence[Thing], dictionary: Dictionary) -> dict[int, str]:
    """Names that are no floor's, by thing id."""
    return {thing.id: thing.name for thing in things if thing.name and not names_a_floor(all_names(thing, dictionary))}


def all_names(thing: Thing, dictionary: Dictionary) -> tuple[str, ...]:
    """A thing's name and its label's aliases; empty without a name."""
    if not thing.name:
        return ()
    label_id = dictionary.id_of(thing.name)
    return (thing.name,) if label_id is None else (thing.name, *dictionary.entries[label_id - 1].aliases)
