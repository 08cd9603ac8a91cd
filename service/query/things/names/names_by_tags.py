"""Suggests names of other scenes for things with the same printed tag."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.things.names.merged_suggestions import TAG_SOURCE
from fastsplat.service.query.things.names.names_by_looks import KnownThing, NameFromScene
from fastsplat.service.scene.artefact.reads import tags_of
from fastsplat.service.scene.artefact.scene import Thing

_STAYS = 0.97
"""Probability that a tag is still on the same thing. Set, not measured."""


def names_by_tags(things: Sequence[Thing], known: Sequence[KnownThing]) -> Mapping[int, NameFromScene]:
    """Suggests names by the tags on each thing, by thing id.

    A tag on several things here, or with several names in one scene, is ignored. If scenes differ, the latest name
    counts: somebody moved the tag. Things that a person named get no suggestion."""
    borne = {thing.id: tags_of(thing.reads) for thing in things}
    count = Counter(tag for tags in borne.values() for tag in tags)
    names: dict[int, NameFromScene] = {}
    for thing in things:
        for tag, here in borne[thing.id].items() if thing.source != "person" else ():
            if count[tag] > 1 or (told := _last_named(tag, known)) is None:
                continue
            probability = _STAYS * here * dict(told.tags)[tag]
            if thing.id not in names or probability > names[thing.id].probability:
                names[thing.id] = NameFromScene(told.name, probability, told.scene_id, TAG_SOURCE)
    return names


def _last_named(tag: str, known: Sequence[KnownThing]) -> KnownThing | None:
    """The thing that last bore a tag; None if its name is ambiguous."""
    bearing = [one for one in known if tag in dict(one.tags)]
    there = [one for one in bearing if one.scene_id == bearing[0].scene_id]
    return there[0] if len({label_key(one.name) for one in there}) == 1 else None
