"""Floor detection by names and by height below the cameras, to exclude table tops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.scene.artefact.scene import Object, Scene
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


def with_floors_judged(scene: Scene, objects: Sequence[Object], owner: NDArray[np.int32]) -> tuple[Object, ...]:
    """Re-judges level surfaces as floors by current names and scale.

    Discovery takes the lowest level surface below the cameras for the floor, before names and often before scale are
    known. A surface with another name is no floor; nor, in a metric scene, one less than `LEAST_BELOW` below the
    cameras, unless a person or the upload calls it a floor. A level surface named as a floor is one."""
    return tuple(_judged(scene, obj, owner) for obj in objects)


def _judged(scene: Scene, obj: Object, owner: NDArray[np.int32]) -> Object:
    if obj.surface not in ("floor", "horizontal surface"):
        return obj
    named = names_a_floor(all_names(obj, scene.dictionary))
    is_floor = named if obj.name else obj.surface == "floor"
    if is_floor and not (named and obj.source in _TRUSTED):
        is_floor = not _near_the_cameras(scene, np.flatnonzero(owner == obj.id))
    return replace(obj, surface="floor" if is_floor else "horizontal surface")


def _near_the_cameras(scene: Scene, rows: NDArray[np.intp]) -> bool:
    up = scene.up()
    if scene.scale != "METRIC" or up is None or not scene.cameras or not len(rows):
        return False
    height = float(np.median(scene.gaussians.means[rows].astype(np.float64) @ up))
    return meters_below(scene.cameras, up, height) < LEAST_BELOW


def floor_ids(objects: Sequence[Object], dictionary: Dictionary) -> list[int]:
    """Ids of floors: judged level surfaces, or unclassified objects with trusted floor names."""
    return [
        obj.id
        for obj in objects
        if obj.surface == "floor"
        or (not obj.surface and obj.source in _TRUSTED and names_a_floor(all_names(obj, dictionary)))
    ]


def names_of_others(objects: Sequence[Object], dictionary: Dictionary) -> dict[int, str]:
    """Names that are no floor's, by object id."""
    return {obj.id: obj.name for obj in objects if obj.name and not names_a_floor(all_names(obj, dictionary))}


def all_names(obj: Object, dictionary: Dictionary) -> tuple[str, ...]:
    """An object's name and its label's aliases; empty without a name."""
    if not obj.name:
        return ()
    label_id = dictionary.id_of(obj.name)
    return (obj.name,) if label_id is None else (obj.name, *dictionary.entries[label_id - 1].aliases)
