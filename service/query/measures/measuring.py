"""Lengths in a scene: between two places, and of an object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fastsplat.service.common.combined_ratios import NORMAL_95
from fastsplat.service.query.measures.locating import Located, axes_of, check_place, locate
from fastsplat.service.query.measures.object_extents import ObjectExtents, object_extents
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scaling import capture_scaling
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.places import Place
from fastsplat_contract.geometry.poses import rigid, vector3
from fastsplat_contract.messages.measurements import Length, LocatedPlace, Measurement

F64 = NDArray[np.float64]


def measure(index: SceneIndex, places: Sequence[Place], version: str) -> Measurement:
    """Measures between two places, an object's size, or a place.

    Raises:
        NotFoundError: nothing is seen at a pixel; no such view or object.
        InvalidInputError: another number of places, or an invalid one, see `locate`.
    """
    if len(places) not in (1, 2):
        raise InvalidInputError(
            f"{len(places)} places", field="places", hint="Send one place to locate or one object, or two places."
        )
    located: list[Located] = []
    extents: dict[int, ObjectExtents] = {}
    for number, place in enumerate(places):
        try:
            if place.object_id is None:
                located.append(locate(index, place))
                continue
            check_place(place, ("object_id",))
            index.objects.check_all((place.object_id,))
            extents[place.object_id] = extents_of(index, place.object_id)
            located.append(_middle(place.object_id, extents[place.object_id]))
        except (InvalidInputError, NotFoundError) as error:
            raise error.within(f"places[{number}]") from error
    distance = center_distance = box = None
    sides: tuple[Length, ...] = ()
    if len(located) == 2:
        distance = _length(index, *_nearest(index, located[0], located[1], extents))
        if any(place.is_object for place in located):
            center_distance = _length(index, *apart(*located))
    elif located[0].is_object:
        measured = extents[located[0].object_id]
        box = measured.box
        sides = tuple(_length(index, *side) for side in zip(box.size, measured.deviations, strict=True))
    return Measurement(
        places=tuple(LocatedPlace(vector3(place.point), place.plus_minus, place.object_id) for place in located),
        distance=distance,
        center_distance=center_distance,
        sides=sides,
        box=box,
        meters=index.scene.scale == "METRIC",
        version=version,
    )


def extents_of(index: SceneIndex, object_id: int) -> ObjectExtents:
    """Measured extents of an object; raises NotFoundError if it is too faint."""
    extents = object_extents(index, object_id)
    if extents is None or index.objects.get(object_id).box is None:
        raise NotFoundError(
            f"object {object_id} is too faint to be seen", field="object_id", hint="Measure an object that has a box."
        )
    return extents


def _middle(object_id: int, extents: ObjectExtents) -> Located:
    """The middle of an object's box, with half of each side's deviation."""
    pose = rigid(extents.box.center.orientation, extents.box.center.position)
    axes, halves = pose[:3, :3], np.array(extents.deviations) / 2
    return Located(pose[:3, 3], axes @ np.diag(halves**2) @ axes.T, object_id, is_object=True)


def _nearest(
    index: SceneIndex, start: Located, end: Located, extents: Mapping[int, ObjectExtents]
) -> tuple[float, float]:
    """Distance and deviation between places; of objects from their nearest Gaussian."""
    if not start.is_object and not end.is_object:
        return apart(start, end)
    if start.is_object and start.object_id == end.object_id and end.is_object:
        return 0.0, 0.0
    means = index.scene.gaussians.means.astype(np.float64)
    sets = [extents[place.object_id].rows if place.is_object else None for place in (start, end)]
    places = zip((start, end), sets, strict=True)
    points = [place.point[None] if rows is None else means[rows] for place, rows in places]
    distances, near = cKDTree(points[1]).query(points[0])
    first = int(np.argmin(distances))
    ends = [
        place if rows is None else _surface(index, int(rows[at]), place.object_id)
        for place, rows, at in zip((start, end), sets, (first, int(near[first])), strict=True)
    ]
    return apart(ends[0], ends[1])


def _surface(index: SceneIndex, row: int, object_id: int) -> Located:
    axes, deviations = axes_of(index, np.array([row]))
    covariance = axes[0] @ np.diag(deviations[0] ** 2) @ axes[0].T
    return Located(index.scene.gaussians.means[row].astype(np.float64), covariance, object_id)


def apart(start: Located, end: Located) -> tuple[float, float]:
    """Distance of points and its deviation √(uᵀ (Σ₁ + Σ₂) u) along u.

    For coinciding points, the deviation in the least certain direction."""
    offset = end.point - start.point
    value = float(np.linalg.norm(offset))
    covariance = start.covariance + end.covariance
    if value == 0:
        return 0.0, float(np.linalg.eigvalsh(covariance)[-1].clip(0)) ** 0.5
    direction = offset / value
    return value, max(float(direction @ covariance @ direction), 0.0) ** 0.5


def _length(index: SceneIndex, value: float, deviation: float) -> Length:
    """Length with the scale's uncertainty added."""
    scaling = index.scene.scaling or capture_scaling(index.scene.facts)
    if scaling is not None:
        deviation = float(np.hypot(deviation, value * scaling.deviation))
    spread = NORMAL_95 * deviation
    return Length(value, max(0.0, value - spread), value + spread)
