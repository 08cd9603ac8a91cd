"""The things of one scene by their names, without their Gaussians."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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

    @cached_property
    def suggested(self) -> Mapping[int, tuple[float, tuple[int, ...]]]:
        """For each label that nothing bears and that is suggested for things without a name: the largest probability,
        and those of these things for which it is at least half as large, the likeliest first."""
        by_id = {self.dictionary.id_of(name): each for name, each in self.suggested_names.items()}
        return {label_id: each for label_id, each in by_id.items() if label_id and label_id not in self.by_label}

    @cached_property
    def suggested_names(self) -> Mapping[str, tuple[float, tuple[int, ...]]]:
        """As `suggested`, of all names that are suggested, by their keys: the dictionary need not have them."""
        likely: dict[str, dict[int, float]] = {}
        for thing in self.present:
            for name, probability in () if thing.name else thing.suggestions:
                likely.setdefault(label_key(name), {})[thing.id] = probability
        ranked = {name: sorted(own.items(), key=lambda each: -each[1]) for name, own in likely.items()}
        return {
            name: (own[0][1], tuple(thing_id for thing_id, each in own if 2 * each >= own[0][1]))
            for name, own in ranked.items()
        }

    def of_labels(self, label_ids: Sequence[int]) -> tuple[int, ...]:
        """The things that bear these labels, or for which those are suggested that nothing bears, in the order of the
        labels."""
        ids = [
            thing_id
            for label_id in label_ids
            for thing_id in self.by_label.get(label_id) or self.suggested.get(label_id, (0.0, ()))[1]
        ]
        return tuple(dict.fromkeys(ids))

    @cached_property
    def called(self) -> Mapping[int, str]:
        """What a sentence calls each thing and part: its name, or "" for none."""
        return {thing.id: thing.name for thing in (*self.present, *self.parts)}

    @cached_property
    def searched(self) -> Searched:
        """What this scene was searched for."""
        unnamed = [thing.id for thing in self.present if not thing.name]
        return Searched(
            len(self.present) - len(unnamed), len(unnamed), tuple(unnamed[:_MAX_UNNAMED]), self.searched_names
        )
