"""Descriptions of things in sentences: by name, else by a neighbor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from fastsplat.service.query.language.sentences.sentences import MOST_NAMED, enumerated, quoted
from fastsplat.service.query.things.names.thing_names import ThingNames

if TYPE_CHECKING:  # scipy loads with the first measurement
    from fastsplat.service.query.things.thing_measures import ThingMeasures

_NEIGHBORS = 8
"""Nearest named things considered as neighbors of an unnamed one."""

OpenMeasures: TypeAlias = "Callable[[], ThingMeasures]"


@dataclass(frozen=True)
class ThingWords:
    """Descriptions of one scene's things; thread-safe."""

    names: ThingNames  # of the things
    _beside: dict[int, str] = field(default_factory=dict)

    def listed(self, thing_ids: Sequence[int], open_measures: OpenMeasures) -> str:
        """Lists at most three: '"mug", 2 of "apple" and the unnamed thing beside the "lamp"'.

        `open_measures` is called only if one of the first has no name."""
        counts: dict[tuple[str, str], int] = {}
        more = 0
        for thing_id in self.names.counted_once(thing_ids):
            name, full = self.names.called.get(thing_id, ""), len(counts) == MOST_NAMED
            key = (name, "") if name else ("", "" if full else self._place(thing_id, open_measures))
            if full and key not in counts:
                more += 1
            else:
                counts[key] = counts.get(key, 0) + 1
        return enumerated([_counted(*key, count) for key, count in counts.items()], more)

    def _place(self, thing_id: int, open_measures: OpenMeasures) -> str:
        """Describes a nameless thing: "wall", or 'thing beside the "mug"'."""
        if thing_id not in self._beside:
            by_id = {thing.id: thing for thing in (*self.names.present, *self.names.parts)}
            thing = by_id.get(thing_id)
            surface = "" if thing is None else thing.surface
            self._beside[thing_id] = surface or f"thing{self._neighbor(thing_id, open_measures())}"
        return self._beside[thing_id]

    def _neighbor(self, thing_id: int, measures: ThingMeasures) -> str:
        """' beside the "mug"' for the clearly nearest named thing; "" for none."""
        from fastsplat.service.query.phrases.relations import is_near, is_next_to

        shape = measures.shape(thing_id)
        named = [thing for thing in self.names.present if thing.name and not thing.surface and thing.id != thing_id]
        others = [(each, other) for each in named if (other := measures.shape(each.id)) is not None]
        if shape is None or not others:
            return ""
        middle = shape.center
        others.sort(key=lambda each: float(np.linalg.norm(each[1].center - middle)))
        judge = is_near if measures.up is None else is_next_to
        judged = [(judge(shape, other).clearness, each.name) for each, other in others[:_NEIGHBORS]]
        clearness, name = max(judged, key=lambda each: each[0])
        if clearness < 1:
            return ""
        alone = sum(thing.name == name for thing in self.names.present) == 1
        return f" beside {'the' if alone else 'a'} {quoted(name)}"


def _counted(name: str, place: str, count: int) -> str:
    if name:
        return quoted(name) if count == 1 else f"{count} of {quoted(name)}"
    if count > 1:
        noun, _, beside = place.partition(" beside ")
        return f"{count} unnamed {noun}s" + (f" beside {beside}" if beside else "")
    return f"{'the' if ' beside ' in place else 'an'} unnamed {place}"
