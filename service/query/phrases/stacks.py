"""Support relations: directly, through other things, or on a wall."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.phrases.relations import Judged, Measured, clearness, gap_between, is_in, is_on
from fastsplat.service.query.things.thing_measures import ThingMeasures, ThingShape
from fastsplat.service.scene.artefact.scene import Thing
from fastsplat_contract.errors import LimitExceededError

_MOST_BETWEEN = 3
_MAX_PAIRS = 4_000
_TOUCHING, _DEVIATIONS = 0.05, 3.0
"""Contact tolerance to a wall: share of the thing's width, and deviations of the surfaces."""


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
                "a question about too many pairs of things",
                field="texts",
                limit=f"{_MAX_PAIRS} pairs",
                hint="Say what things they are, or what they are related to.",
            )


@dataclass
class Stacks:
    """Support relations among the things of one scene."""

    measures: ThingMeasures  # of the things
    things: Mapping[int, Thing]  # that are there, by id; parts, too
    budget: PairBudget  # of pairs
    _direct: dict[tuple[int, int], Judged] = field(default_factory=dict)

    def direct(self, one: ThingShape, other: ThingShape) -> Judged:
        """Judges if one thing rests on another, see `is_on`; cached."""
        key = (one.id, other.id)
        if key not in self._direct:
            self.budget.spend()
            self._direct[key] = is_on(one, other)
        return self._direct[key]

    def rests_on(self, one: ThingShape, other: ThingShape) -> Judged:
        """Judges if one thing is on another, or hangs on a wall or ceiling.

        A hanging thing touches it while nothing else carries it. Undecided if something between rests on the other."""
        surface = self.things[other.id].surface if other.id in self.things else ""
        if surface in ("wall", "ceiling"):
            return self._hangs_on(one, other)
        direct = self.direct(one, other)
        if direct.clearness <= -1 and self._carried(one, other, _MOST_BETWEEN):
            return Judged(0.0, direct.measured, "indirect")
        return direct

    def _hangs_on(self, one: ThingShape, wall: ThingShape) -> Judged:
        gap = gap_between(one, wall)
        near = _DEVIATIONS * max(one.deviation, wall.deviation) + _TOUCHING * one.width
        touches = Measured("gap", gap, "length", clearness(gap, near, 3 * near))
        carried = touches.clearness > -1 and any(
            self.direct(one, carrier).clearness >= 1
            for carrier in self._carriers()
            if carrier.id not in (one.id, wall.id)
        )
        return Judged(min(touches.clearness, -1.0) if carried else touches.clearness, (touches,))

    def _carried(self, one: ThingShape, other: ThingShape, most: int) -> bool:
        """True if a thing may rest on the other through at most `most` things."""
        if most == 0 or one.low <= other.low or not _may_touch(one, other):
            return False
        for carrier in self._carriers():
            if carrier.id in (one.id, other.id) or carrier.low > one.high or not _may_touch(one, carrier):
                continue
            carries = max(self.direct(one, carrier).clearness, is_in(one, carrier).clearness) > -1
            if carries and (self.direct(carrier, other).clearness > -1 or self._carried(carrier, other, most - 1)):
                return True
        return False

    def _carriers(self) -> list[ThingShape]:
        """Whole things that may carry others: all but walls and ceilings."""
        sides = ("wall", "ceiling")
        ids = (thing.id for thing in self.things.values() if not thing.parent and thing.surface not in sides)
        return [shape for thing_id in ids if (shape := self.measures.shape(thing_id)) is not None]


def _may_touch(one: ThingShape, other: ThingShape) -> bool:
    """True if the outlines along the axes overlap."""
    return bool((one.bounds[0] <= other.bounds[1]).all() and (other.bounds[0] <= one.bounds[1]).all())
