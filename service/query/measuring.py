"""Lengths in a scene: between two places, of a thing; and the scale that known lengths give it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fastsplat.service.common.combined_ratios import NORMAL_95
from fastsplat.service.query.locating import Located, axes_of, check_place, locate
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.thing_extents import ThingExtents, thing_extents
from fastsplat.service.scene.scaling import ScaledLength, capture_scaling, combined, scaled
from fastsplat.service.scene.types import Scene
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.measure_messages import Length, LocatedPlace, Measurement
from fastsplat_contract.places import KnownSize, Place
from fastsplat_contract.poses import rigid, vector3

if TYPE_CHECKING:
    from fastsplat.service.query.edits import Edit

F64 = NDArray[np.float64]

_MAX_LENGTHS = 100
_UNSURE_ENDS = 0.03
"""Of a thing's length, what its ends are unsure of where it gives the scene its scale."""


def measure(index: SceneIndex, places: Sequence[Place], version: str) -> Measurement:
    """What is between two places, how large a thing is, or where one place is.

    Args:
        index: of the scene.
        places: one or two.
        version: that the index is of.

    Raises:
        NotFoundError: nothing is seen at a pixel; no such view or thing.
        InvalidInputError: another number of places, or one that makes no sense, see `locate`.
    """
    if len(places) not in (1, 2):
        raise InvalidInputError(
            f"{len(places)} places", field="places", hint="Send one place to locate or one thing, or two places."
        )
    located: list[Located] = []
    extents: dict[int, ThingExtents] = {}
    for number, place in enumerate(places):
        try:
            if place.thing is None:
                located.append(locate(index, place))
                continue
            check_place(place, ("thing",))
            index.things.check_all((place.thing,))
            extents[place.thing] = _extents(index, place.thing)
            located.append(_middle(place.thing, extents[place.thing]))
        except (InvalidInputError, NotFoundError) as error:
            raise error.within(f"places[{number}]") from error
    distance = center_distance = box = None
    sides: tuple[Length, ...] = ()
    if len(located) == 2:
        distance = _length(index, *_nearest(index, located[0], located[1], extents))
        if any(one.is_thing for one in located):
            center_distance = _length(index, *_apart(*located))
    elif located[0].is_thing:
        measured = extents[located[0].thing_id]
        box = measured.box
        sides = tuple(_length(index, *side) for side in zip(box.size, measured.deviations, strict=True))
    return Measurement(
        places=tuple(LocatedPlace(vector3(one.point), one.plus_minus, one.thing_id) for one in located),
        distance=distance,
        center_distance=center_distance,
        sides=sides,
        box=box,
        meters=index.scene.scale == "METRIC",
        version=version,
    )


def scale_scene(index: SceneIndex, edit: Edit) -> Scene:
    """The scene in meters by known lengths, and by those that it was scaled by before; see `combined`.

    Raises:
        NotFoundError: nothing is seen at a pixel; no such view.
        InvalidInputError: no or too many known lengths, a label, an object or things, or two places that are one.
    """
    if edit.label is not None or edit.object_id is not None or edit.things:
        raise InvalidInputError("scale is of the whole scene", field="label", hint="Send known lengths alone.")
    earlier = index.scene.scaling or capture_scaling(index.scene.quality)
    lengths = [] if earlier is None else [*earlier.lengths]
    known_count = len(edit.known_lengths) + len(edit.known_sizes)
    if not known_count or len(lengths) + known_count > _MAX_LENGTHS:
        raise InvalidInputError(
            f"{known_count} known lengths and sizes",
            field="known_lengths",
            limit=f"1 to {_MAX_LENGTHS} of a scene",
            hint="Send the length between two places, or the size of a thing.",
        )
    unit = 1.0 if earlier is None else earlier.meters_per_unit
    for number, known in enumerate(edit.known_lengths):
        ends = []
        for name in ("first", "second"):
            try:
                ends.append(locate(index, getattr(known, name)))
            except (InvalidInputError, NotFoundError) as error:
                raise error.within(f"known_lengths[{number}].{name}") from error
        value, deviation = _apart(*ends)
        if value <= 3 * deviation or value < np.finfo(np.float32).tiny:
            raise InvalidInputError(
                "the two places cannot be told apart",
                field=f"known_lengths[{number}].second",
                hint="Pick places that are further from each other.",
            )
        lengths.append(ScaledLength(value / unit, deviation / unit, known.meters, known.plus_minus / NORMAL_95))
    lengths += [_known_size(index, known, number, unit) for number, known in enumerate(edit.known_sizes)]
    return scaled(index.things.scene, combined(lengths))


def _known_size(index: SceneIndex, known: KnownSize, number: int, unit: float) -> ScaledLength:
    """A thing's measured side as a known length. A scale lasts, and where a trained thing ends is nowhere surer than a
    few per cent of its length: that much is added."""
    try:
        index.things.check_all((known.thing,))
        thing = _extents(index, known.thing)
    except (InvalidInputError, NotFoundError) as error:
        raise error.within(f"known_sizes[{number}]") from error
    if known.side == "height" and index.scene.up() is None:
        raise InvalidInputError(
            "the scene does not tell what is up",
            field=f"known_sizes[{number}].side",
            hint="Send the longest side, or a length between two places.",
        )
    side = 2 if known.side == "height" else int(np.argmax(thing.box.size))
    value = thing.box.size[side]
    deviation = float(np.hypot(thing.deviations[side], _UNSURE_ENDS * value))
    if value <= 3 * deviation or value < np.finfo(np.float32).tiny:
        raise InvalidInputError(
            f"the size of thing {known.thing} is too unsure to scale by",
            field=f"known_sizes[{number}].thing",
            hint="Use a larger thing, or a length between two places.",
        )
    return ScaledLength(value / unit, deviation / unit, known.meters, known.plus_minus / NORMAL_95)


def _extents(index: SceneIndex, thing_id: int) -> ThingExtents:
    extents = thing_extents(index, thing_id)
    if extents is None or index.things.get(thing_id).box is None:
        raise NotFoundError(
            f"thing {thing_id} is too faint to be seen", field="thing", hint="Measure a thing that has a box."
        )
    return extents


def _middle(thing_id: int, extents: ThingExtents) -> Located:
    """A thing as a place: the middle of its box, as sure as half of each side."""
    pose = rigid(extents.box.center.orientation, extents.box.center.position)
    axes, halves = pose[:3, :3], np.array(extents.deviations) / 2
    return Located(pose[:3, 3], axes @ np.diag(halves**2) @ axes.T, thing_id, is_thing=True)


def _nearest(
    index: SceneIndex, one: Located, other: Located, extents: Mapping[int, ThingExtents]
) -> tuple[float, float]:
    """Distance and deviation between two places; of a thing from its surface, the Gaussian nearest to the other."""
    if not one.is_thing and not other.is_thing:
        return _apart(one, other)
    if one.is_thing and one.thing_id == other.thing_id and other.is_thing:
        return 0.0, 0.0
    means = index.scene.gaussians.means.astype(np.float64)
    sets = [extents[place.thing_id].rows if place.is_thing else None for place in (one, other)]
    points = [one.point[None] if sets[0] is None else means[sets[0]]]
    points.append(other.point[None] if sets[1] is None else means[sets[1]])
    distances, near = cKDTree(points[1]).query(points[0])
    first = int(np.argmin(distances))
    ends = [
        place if rows is None else _surface(index, int(rows[at]), place.thing_id)
        for place, rows, at in zip((one, other), sets, (first, int(near[first])), strict=True)
    ]
    return _apart(ends[0], ends[1])


def _surface(index: SceneIndex, row: int, thing_id: int) -> Located:
    axes, deviations = axes_of(index, np.array([row]))
    covariance = axes[0] @ np.diag(deviations[0] ** 2) @ axes[0].T
    return Located(index.scene.gaussians.means[row].astype(np.float64), covariance, thing_id)


def _apart(one: Located, other: Located) -> tuple[float, float]:
    """Distance of two points, and its standard deviation √(uᵀ (Σ₁ + Σ₂) u), u the direction from one to the other; of
    points that are one, in the least certain direction."""
    offset = other.point - one.point
    value = float(np.linalg.norm(offset))
    covariance = one.covariance + other.covariance
    if value == 0:
        return 0.0, float(np.linalg.eigvalsh(covariance)[-1].clip(0)) ** 0.5
    direction = offset / value
    return value, max(float(direction @ covariance @ direction), 0.0) ** 0.5


def _length(index: SceneIndex, value: float, deviation: float) -> Length:
    """With what the scale is unsure of added to what the places are."""
    scaling = index.scene.scaling or capture_scaling(index.scene.quality)
    if scaling is not None:
        deviation = float(np.hypot(deviation, value * scaling.deviation))
    spread = NORMAL_95 * deviation
    return Length(value, max(0.0, value - spread), value + spread)
