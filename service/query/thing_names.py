"""The things of one scene by their names, without their Gaussians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from fastsplat.service.common.dictionary import Dictionary, label_key
from fastsplat.service.scene.types import Thing
from fastsplat_contract.queries import Searched

_MAX_UNNAMED = 100


@dataclass(frozen=True)
class ThingNames:
    """Names of things. Threads may share it.

    Attributes:
        dictionary: of the scene.
        present: the things that have Gaussians, by id.
        parts: those of them that have Gaussians, by the ids of the things, then by their own.
        searched_names: how many names were looked for; None if nobody noted it.
    """

    dictionary: Dictionary
    present: tuple[Thing, ...]
    parts: tuple[Thing, ...]
    searched_names: int | None

    @cached_property
    def by_label(self) -> Mapping[int, tuple[int, ...]]:
        """The ids of the things and parts that bear each label, things first; of labels that one bears."""
        ids: dict[int, tuple[int, ...]] = {}
        for thing in (*self.present, *self.parts):
            if thing.name and (label_id := self.dictionary.id_of(thing.name)):
                ids[label_id] = (*ids.get(label_id, ()), thing.id)
        return ids

    @cached_property
    def probabilities(self) -> Mapping[int, float]:
        """For each label that a thing or a part bears the largest probability of their names."""
        sure = {thing.id: thing.probability for thing in (*self.present, *self.parts)}
        return {label_id: max(sure[thing_id] for thing_id in ids) for label_id, ids in self.by_label.items()}

    def suggested(self, name: str) -> tuple[float, tuple[int, ...]]:
        """The largest probability with which this name is suggested for things without one, and these things; 0 for
        none."""
        return self._suggested.get(label_key(name), (0.0, ()))

    @cached_property
    def _suggested(self) -> Mapping[str, tuple[float, tuple[int, ...]]]:
        names: dict[str, tuple[float, tuple[int, ...]]] = {}
        for thing in self.present:
            for name, probability in () if thing.name else thing.suggestions:
                most, ids = names.get(label_key(name), (0.0, ()))
                names[label_key(name)] = (max(most, probability), (*ids, thing.id))
        return names

    @cached_property
    def searched(self) -> Searched:
        """What this scene was searched for."""
        unnamed = [thing.id for thing in self.present if not thing.name]
        return Searched(
            len(self.present) - len(unnamed), len(unnamed), tuple(unnamed[:_MAX_UNNAMED]), self.searched_names
        )
