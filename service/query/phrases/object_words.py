"""Descriptions of objects in sentences: by name, else by a neighbor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from fastsplat.service.query.language.sentences.sentences import MOST_NAMED, enumerated, quoted
from fastsplat.service.query.objects.names.object_names import ObjectNames

if TYPE_CHECKING:  # scipy loads with the first measurement
    from fastsplat.service.query.objects.object_measures import ObjectMeasures

_NEIGHBORS = 8
"""Nearest named objects considered as neighbors of an unnamed one."""

OpenMeasures: TypeAlias = "Callable[[], ObjectMeasures]"


@dataclass(frozen=True)
class ObjectWords:
    """Descriptions of one scene's objects; thread-safe."""

    names: ObjectNames  # of the objects
    _beside: dict[int, str] = field(default_factory=dict)

    def listed(self, object_ids: Sequence[int], open_measures: OpenMeasures) -> str:
        """Lists at most three: '"mug", 2 of "apple" and the unnamed object beside the "lamp"'.

        `open_measures` is called only if one of the first has no name."""
        counts: dict[tuple[str, str], int] = {}
        more = 0
        for object_id in self.names.counted_once(object_ids):
            name, full = self.names.called.get(object_id, ""), len(counts) == MOST_NAMED
            key = (name, "") if name else ("", "" if full else self._place(object_id, open_measures))
            if full and key not in counts:
                more += 1
            else:
                counts[key] = counts.get(key, 0) + 1
        return enumerated([_counted(*key, count) for key, count in counts.items()], more)

    def _place(self, object_id: int, open_measures: OpenMeasures) -> str:
        """Describes a nameless object: "wall", or 'object beside the "mug"'."""
        if object_id not in self._beside:
            by_id = {obj.id: obj for obj in (*self.names.present, *self.names.parts)}
            obj = by_id.get(object_id)
            surface = "" if obj is None else obj.surface
            self._beside[object_id] = surface or f"object{self._neighbor(object_id, open_measures())}"
        return self._beside[object_id]

    def _neighbor(self, object_id: int, measures: ObjectMeasures) -> str:
        """' beside the "mug"' for the clearly nearest named object; "" for none."""
        from fastsplat.service.query.phrases.relations import is_near, is_next_to

        shape = measures.shape(object_id)
        named = [obj for obj in self.names.present if obj.name and not obj.surface and obj.id != object_id]
        neighbors = [(obj, other_shape) for obj in named if (other_shape := measures.shape(obj.id)) is not None]
        if shape is None or not neighbors:
            return ""
        middle = shape.center
        neighbors.sort(key=lambda pair: float(np.linalg.norm(pair[1].center - middle)))
        judge = is_near if measures.up is None else is_next_to
        judged = [(judge(shape, other_shape).clearness, obj.name) for obj, other_shape in neighbors[:_NEIGHBORS]]
        clearness, name = max(judged, key=lambda pair: pair[0])
        if clearness < 1:
            return ""
        alone = sum(obj.name == name for obj in self.names.present) == 1
        return f" beside {'the' if alone else 'a'} {quoted(name)}"


def _counted(name: str, place: str, count: int) -> str:
    if name:
        return quoted(name) if count == 1 else f"{count} of {quoted(name)}"
    if count > 1:
        noun, _, beside = place.partition(" beside ")
        return f"{count} unnamed {noun}s" + (f" beside {beside}" if beside else "")
    return f"{'the' if ' beside ' in place else 'an'} unnamed {place}"
