"""What carries a thing: what it rests on, hangs on or is in, by the relations that answer questions."""

from __future__ import annotations

from collections.abc import Iterator

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.phrases.relations import Judged, is_in
from fastsplat.service.query.phrases.stacks import PairBudget, Stacks
from fastsplat.service.query.things.thing_index import SceneThings
from fastsplat.service.query.things.thing_measures import ThingShape
from fastsplat_contract.detection_messages import Support, SupportRelation

_HOLDS = 1.0
_FLAT = ("wall", "ceiling")
_FLAT_SHARE = 0.2
"""Of its width, what is less high holds nothing: table tops and trays; on a trained table a bowl has 0.4, a plate 0.26,
the table 0.09."""


def carrier_of(things: SceneThings, thing_id: int) -> Support | None:
    """What carries a thing: of all that it clearly rests on, or is clearly in, the clearest; else a wall or a ceiling
    that it clearly hangs on. None where nothing is clear, and for a floor, a wall or a ceiling itself.

    Raises:
        CancelledError: nobody waits for the answer any more.
        LimitExceededError: too many pairs of things.
    """
    by_id = {thing.id: thing for thing in things.present}
    one = things.measures.shape(thing_id)
    if one is None or by_id[thing_id].surface in ("floor", *_FLAT):
        return None
    stacks = Stacks(things.measures, by_id, PairBudget())
    others = [shape for other in by_id if other != thing_id and (shape := things.measures.shape(other)) is not None]
    below = [other for other in others if by_id[other.id].surface not in _FLAT and _may_carry(one, other)]
    best = _clearest(judged for other in below for judged in _carried(stacks, one, other))
    if best is None:
        walls = [other for other in others if by_id[other.id].surface in _FLAT and _overlapping(one, other)]
        best = _clearest((other.id, "on", stacks.rests_on(one, other)) for other in walls)
    if best is None:
        return None
    carrier, relation, clear = best
    return Support(carrier, by_id[carrier].name, relation, clear)


def _carried(stacks: Stacks, one: ThingShape, other: ThingShape) -> Iterator[tuple[int, SupportRelation, Judged]]:
    check_cancelled()
    yield other.id, "on", stacks.direct(one, other)
    # Nothing is in what is as flat as a table top: in its unsharp surface is on it.
    flat = other.high - other.low < _FLAT_SHARE * other.width
    yield other.id, "on" if flat else "in", is_in(one, other)


def _clearest(judged: Iterator[tuple[int, SupportRelation, Judged]]) -> tuple[int, SupportRelation, float] | None:
    holding = [(carrier, relation, each.clearness) for carrier, relation, each in judged if each.clearness >= _HOLDS]
    return max(holding, key=lambda each: each[2], default=None)


def _may_carry(one: ThingShape, other: ThingShape) -> bool:
    """Whether the outlines along the axes overlap, and the other begins below the one's top."""
    return other.low < one.high and bool(
        (one.bounds[0] <= other.bounds[1]).all() and (other.bounds[0] <= one.bounds[1]).all()
    )


def _overlapping(one: ThingShape, wall: ThingShape) -> bool:
    """Whether a wall may be within reach: nearer along each axis than the thing is wide."""
    reach = one.width
    low, high = wall.bounds[0] - reach, wall.bounds[1] + reach
    return bool((one.bounds[0] <= high).all() and (low <= one.bounds[1]).all())
