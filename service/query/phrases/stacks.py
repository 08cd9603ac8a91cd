"""Support relations: directly, through other objects, or on a wall."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.objects.object_measures import ObjectMeasures, ObjectShape
from fastsplat.service.query.phrases.relations import Judged, Measured, clearness, gap_between, is_in, is_on
from fastsplat.service.scene.artefact.scene import Object
from fastsplat_contract.errors import LimitExceededError

_MOST_BETWEEN = 3
_MAX_PAIRS = 4_000
_TOUCHING, _DEVIATIONS = 0.05, 3.0
"""Contact tolerance to a wall: share of the object's width, and deviations of the surfaces."""


class PairBudget:
    """Limit of measured pairs per question: "what is near anything?" has all of them."""

    def __init__(self) -> None:
        self._left = _MAX_PAIRS

    def spend(self, count: int = 1) -> None:
        """Counts pairs; raises LimitExceededError beyond the limit. Cancellable."""
        check_cancelled()
        self._left -= count
        if self._left < 0:
            raise LimitExceededError(
                "a question about too many pairs of objects",
                field="texts",
                limit=f"{_MAX_PAIRS} pairs",
                hint="Say what objects they are, or what they are related to.",
            )


@dataclass
class Stacks:
    """Support relations among the objects of one scene."""

    measures: ObjectMeasures  # of the objects
    objects: Mapping[int, Object]  # that are there, by id; parts, too
    budget: PairBudget  # of pairs
    _direct: dict[tuple[int, int], Judged] = field(default_factory=dict)

    def direct(self, shape: ObjectShape, support: ObjectShape) -> Judged:
        """Judges if one object rests on another, see `is_on`; cached."""
        key = (shape.id, support.id)
        if key not in self._direct:
            self.budget.spend()
            self._direct[key] = is_on(shape, support)
        return self._direct[key]

    def rests_on(self, shape: ObjectShape, support: ObjectShape) -> Judged:
        """Judges if one object is on another, or hangs on a wall or ceiling.

        A hanging object touches it while nothing else carries it. Undecided if something between rests on the other."""
        surface = self.objects[support.id].surface if support.id in self.objects else ""
        if surface in ("wall", "ceiling"):
            return self._hangs_on(shape, support)
        direct = self.direct(shape, support)
        if direct.clearness <= -1 and self._carried(shape, support, _MOST_BETWEEN):
            return Judged(0.0, direct.measured, "indirect")
        return direct

    def _hangs_on(self, shape: ObjectShape, wall: ObjectShape) -> Judged:
        gap = gap_between(shape, wall)
        near = _DEVIATIONS * max(shape.deviation, wall.deviation) + _TOUCHING * shape.width
        touches = Measured("gap", gap, "length", clearness(gap, near, 3 * near))
        carried = touches.clearness > -1 and any(
            self.direct(shape, carrier).clearness >= 1
            for carrier in self._carriers()
            if carrier.id not in (shape.id, wall.id)
        )
        return Judged(min(touches.clearness, -1.0) if carried else touches.clearness, (touches,))

    def _carried(self, shape: ObjectShape, support: ObjectShape, most: int) -> bool:
        """True if an object may rest on the other through at most `most` objects."""
        if most == 0 or shape.low <= support.low or not bounds_overlap(shape, support):
            return False
        for carrier in self._carriers():
            if carrier.id in (shape.id, support.id) or carrier.low > shape.high or not bounds_overlap(shape, carrier):
                continue
            carries = max(self.direct(shape, carrier).clearness, is_in(shape, carrier).clearness) > -1
            if carries and (self.direct(carrier, support).clearness > -1 or self._carried(carrier, support, most - 1)):
                return True
        return False

    def _carriers(self) -> list[ObjectShape]:
        """Whole objects that may carry others: all but walls and ceilings."""
        sides = ("wall", "ceiling")
        ids = (obj.id for obj in self.objects.values() if not obj.parent and obj.surface not in sides)
        return [shape for object_id in ids if (shape := self.measures.shape(object_id)) is not None]


def bounds_overlap(first: ObjectShape, second: ObjectShape) -> bool:
    """True if the outlines along the axes overlap."""
    return bool((first.bounds[0] <= second.bounds[1]).all() and (second.bounds[0] <= first.bounds[1]).all())
