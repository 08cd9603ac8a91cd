"""Index of a scene's names and the objects that bear them, without Gaussians."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import dist, hypot, prod
from statistics import median

import numpy as np

from fastsplat.service.common.dictionary import MAX_LABELS, Dictionary, DictionaryEntry, label_key
from fastsplat.service.query.objects.absence import USUAL_M
from fastsplat.service.query.objects.names.merged_suggestions import Trust, merged_suggestions, source_trust
from fastsplat.service.query.objects.names.names_from_scenes import NameFromScene
from fastsplat.service.scene.artefact.scene import Object, Scene
from fastsplat.service.scene.artefact.suggestions import SaidName, Suggestion
from fastsplat_contract.geometry.poses import Box
from fastsplat_contract.messages.queries import Answer, Searched

_MAX_UNNAMED = 100
_GRID, _SLACK = 5, 0.05
"""Samples along each edge of a box, and its enlargement relative to its longest edge."""
_SPECK, _AROUND = 0.125, 0.5
"""Volume ratio below which an object is a speck of another, and its slack."""


@dataclass(frozen=True)
class Name:
    """A name and the objects that bear it.

    Attributes:
        objects: ids of the objects, then parts, that bear it; else those for which it is suggested with at least half
            of
            `probability`, likeliest first.
    """

    label: str  # as it is shown
    objects: tuple[int, ...]
    probability: float  # 0..1, the largest with which it belongs to one of them
    suggested: bool  # whether nothing bears it, neither an object nor, by themselves, Gaussians
    sources: tuple[str, ...] = ()  # who suggests it, but for the scene's own models


@dataclass(frozen=True)
class _SuggestedName:
    """A suggested name: probability by object, other words and sources."""

    name: str
    likely: dict[int, float] = field(default_factory=dict)
    aliases: dict[str, None] = field(default_factory=dict)
    sources: dict[str, None] = field(default_factory=dict)


@dataclass(frozen=True)
class ObjectNames:
    """Names of objects; thread-safe.

    Attributes:
        marked: confidence by label id of labels that Gaussians have by themselves; empty if labels are objects' names.
        said_elsewhere: earlier suggestions for objects that people named in the project's other scenes.
        stored: the scene stores its objects; if not, `present` is empty until those of its labels are computed.
    """

    labels: Dictionary  # the scene's dictionary
    present: tuple[Object, ...]  # the objects that have Gaussians, by id
    parts: tuple[Object, ...]  # those of them that have Gaussians, by the ids of the objects, then by their own
    searched_names: int | None  # how many names were looked for; None if nobody noted it
    marked: Mapping[int, float] = field(default_factory=dict)
    said_elsewhere: tuple[SaidName, ...] = ()
    stored: bool = True
    counts: Mapping[int, int] = field(default_factory=dict, repr=False)  # Gaussians by object or part id
    searched_for: tuple[str, ...] = ()  # the names that were looked for, as far as somebody noted them
    boxes: Mapping[int, Box] = field(default_factory=dict, repr=False)  # of the objects that can be seen, by their ids
    metric: bool = False  # whether the unit of these is the meter

    @cached_property
    def dictionary(self) -> Dictionary:
        """The keys: the scene's labels, then suggested names that it lacks."""
        lacking = [name for name in self._suggestions.values() if self.labels.id_of(name.name) is None]
        taken = {label_key(name.name) for name in lacking}
        entries = list(self.labels.entries)
        for name in lacking[: MAX_LABELS - len(self.labels)]:
            words = {label_key(alias): alias for alias in name.aliases}
            free = {key: word for key, word in words.items() if key not in taken and self.labels.id_of(word) is None}
            taken |= free.keys()
            entries.append(DictionaryEntry(name.name, tuple(free.values())))
        return Dictionary(tuple(entries)) if lacking else self.labels

    @cached_property
    def table(self) -> Mapping[int, Name]:
        """Owners of each name, by id in `dictionary`: borne names, surest first, then suggested."""
        sureness = {obj.id: obj.probability for obj in self._everything}
        suggested = {self.dictionary.id_of(suggestion.name): suggestion for suggestion in self._suggestions.values()}
        names: dict[int, Name] = {}
        for label_id in range(1, len(self.dictionary) + 1):
            bearing, proposal = self.by_label.get(label_id, ()), suggested.get(label_id)
            chances = {} if proposal is None else proposal.likely
            borne = bool(bearing) or label_id in self.marked
            if borne or chances:
                most = max(chances.values(), default=0.0)
                ordered = sorted(chances, key=lambda object_id: -chances[object_id])
                likely = tuple(object_id for object_id in ordered if 2 * chances[object_id] >= most)
                sure = max((sureness[object_id] for object_id in bearing), default=self.marked.get(label_id, 0.0))
                label, sources = self.dictionary.label_of(label_id), tuple(proposal.sources) if proposal else ()
                names[label_id] = Name(label, bearing or likely, sure if borne else most, not borne, sources)
        order = sorted(names, key=lambda label_id: (names[label_id].suggested, -names[label_id].probability, label_id))
        return {label_id: names[label_id] for label_id in order}

    @cached_property
    def by_label(self) -> Mapping[int, tuple[int, ...]]:
        """Ids of the objects and parts that bear each label, objects first."""
        ids: dict[int, tuple[int, ...]] = {}
        for obj in self._everything:
            if obj.name and (label_id := self.labels.id_of(obj.name)):
                ids[label_id] = (*ids.get(label_id, ()), obj.id)
        return ids

    @cached_property
    def trust(self) -> Trust:
        """Trust in each source of suggestions, by what people named here and elsewhere."""
        return source_trust([*self.said_elsewhere, *(said for obj in self._everything for said in obj.said)])

    @cached_property
    def sources(self) -> frozenset[str]:
        """Sources of suggestions, without the scene's own models."""
        return frozenset(said.source for obj in self._everything for said in obj.suggestions if said.source)

    @cached_property
    def _suggestions(self) -> Mapping[int | str, _SuggestedName]:
        """Suggested names by label id, or by key if the dictionary lacks them."""
        names: dict[int | str, _SuggestedName] = {}
        for obj in self._everything:
            for name in merged_suggestions(obj, self.trust):
                key = self.labels.id_of(name.name) or label_key(name.name)
                entry = names.setdefault(key, _SuggestedName(name.name))
                entry.likely[obj.id] = max(name.probability, entry.likely.get(obj.id, 0.0))
                entry.aliases.update(dict.fromkeys(name.aliases))
                entry.sources.update(dict.fromkeys(said.source for said in name.suggestions if said.source))
        return names

    @property
    def _everything(self) -> tuple[Object, ...]:
        return (*self.present, *self.parts)

    def of_labels(self, label_ids: Sequence[int]) -> tuple[int, ...]:
        """The objects that these names belong to, in order of the names."""
        names = [self.table[label_id] for label_id in label_ids if label_id in self.table]
        return tuple(dict.fromkeys(object_id for name in names for object_id in name.objects))

    def suggesting(self, elsewhere: Mapping[int, NameFromScene], said: Sequence[SaidName] = ()) -> ObjectNames:
        """Adds suggestions from other scenes, by object id, and what sources said there."""

        def suggested(obj: Object) -> Object:
            name = elsewhere[obj.id]
            rest = [
                suggestion
                for suggestion in obj.suggestions
                if suggestion.source != name.source or label_key(suggestion.name) != label_key(name.name)
            ]
            return replace(obj, suggestions=(Suggestion(name.name, name.probability, name.source), *rest))

        return replace(
            self,
            present=tuple(suggested(obj) if obj.id in elsewhere else obj for obj in self.present),
            said_elsewhere=tuple(said),
        )

    def is_borne(self, label_id: int) -> bool:
        """True if an object or Gaussian bears a name."""
        return label_id in self.table and not self.table[label_id].suggested

    def picks(self, answer: Answer) -> tuple[int, ...] | None:
        """The objects that an answer picks; None if all of its labels."""
        borne = any(map(self.is_borne, answer.relevant_ids))
        return answer.object_ids if answer.phrase is not None or (answer.object_ids and not borne) else None

    def counted(self, answer: Answer) -> Answer:
        """Restricts the Gaussian counts of relevant entries to the picked objects."""
        picked = self.picks(answer)
        if picked is None:
            return answer

        def count(label_id: int) -> int:
            ids = self.of_labels((label_id,))
            return sum(self.counts.get(object_id, 0) for object_id in ids if object_id in picked)

        matches = (
            match._replace(gaussian_count=count(match.label_id)) if match.relevant else match
            for match in answer.matches
        )
        return replace(answer, matches=tuple(matches))

    @cached_property
    def lengths(self) -> Mapping[int, float]:
        """Longest edge of each visible object, meters; without meters, of the median object `USUAL_M`."""
        edges = {obj.id: max(self.boxes[obj.id].size) for obj in self.present if obj.id in self.boxes}
        usual = [edges[obj.id] for obj in self.present if obj.id in edges and not obj.surface]
        meter = 1.0 if self.metric or not usual else median(usual) / USUAL_M or 1.0
        return {object_id: edge / meter for object_id, edge in edges.items()}

    def counted_once(self, object_ids: Sequence[int]) -> tuple[int, ...]:
        """Drops fragments: objects that lie in the place of another one of their name."""
        boxes = {object_id: self.boxes[object_id] for object_id in object_ids if object_id in self.boxes}
        wholes: list[int] = []
        for piece in sorted(boxes, key=lambda box: -prod(boxes[box].size)):
            name = self.called.get(piece)
            alike = [whole for whole in wholes if name and self.called[whole] == name]
            if not any(_lies_in(boxes[piece], boxes[whole]) for whole in alike):
                wholes.append(piece)
        return tuple(object_id for object_id in object_ids if object_id in wholes or object_id not in boxes)

    @cached_property
    def called(self) -> Mapping[int, str]:
        """The name of each object and part; "" for none."""
        return {obj.id: obj.name for obj in self._everything}

    @cached_property
    def taken_for(self) -> Mapping[int, str]:
        """Each object's name, else its likeliest suggestion or ""; without stored objects, labels by id."""
        if not self.stored:
            return {number: entry.label for number, entry in enumerate(self.labels.entries, start=1)}
        return {obj.id: obj.name or (obj.suggestions[0].name if obj.suggestions else "") for obj in self.present}

    @cached_property
    def searched(self) -> Searched:
        """Summary of the search of this scene."""
        unnamed = [obj.id for obj in self.present if not obj.name]
        named = len(self.present) - len(unnamed) if self.stored else None
        return Searched(named, len(unnamed), tuple(unnamed[:_MAX_UNNAMED]), self.searched_names)


def _lies_in(box: Box, outer: Box) -> bool:
    """True if most of a box is in another one; for specks, with more slack."""
    slack = _AROUND if prod(box.size) < _SPECK * prod(outer.size) else _SLACK
    reach = hypot(*outer.size) / 2 + 2 * slack * max(outer.size)
    if dist(box.center.position, outer.center.position) > reach:  # most of a box lies around its middle
        return False
    grid = np.stack(np.meshgrid(*3 * [np.linspace(-0.5, 0.5, _GRID)]), axis=-1).reshape(-1, 3)
    world = grid * box.size @ box.center.matrix()[:3, :3].T + box.center.position
    local = (world - outer.center.position) @ outer.center.matrix()[:3, :3]
    inside = np.abs(local) <= np.array(outer.size) / 2 + slack * max(outer.size)
    return bool(2 * inside.all(axis=1).sum() > len(grid))


def names_of(scene: Scene, of_objects: ObjectNames | None, counts: Sequence[int]) -> ObjectNames:
    """Builds the names of a scene; `counts`: Gaussians of each label, 0 first."""
    names = of_objects or ObjectNames(scene.dictionary, (), (), scene.facts.searched_names, stored=False)
    entries = () if scene.label_mode == "objects" else enumerate(scene.dictionary.entries, start=1)
    return replace(names, marked={label_id: entry.confidence for label_id, entry in entries if counts[label_id]})
