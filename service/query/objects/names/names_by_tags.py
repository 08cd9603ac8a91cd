"""Suggests names of other scenes for objects with the same printed tag."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.objects.names.merged_suggestions import TAG_SOURCE
from fastsplat.service.query.objects.names.names_by_looks import KnownObject, NameFromScene
from fastsplat.service.scene.artefact.reads import tags_of
from fastsplat.service.scene.artefact.scene import Object

_STAYS = 0.97
"""Probability that a tag is still on the same object. Set, not measured."""


def names_by_tags(objects: Sequence[Object], known: Sequence[KnownObject]) -> Mapping[int, NameFromScene]:
    """Suggests names by the tags on each object, by object id.

    A tag on several objects here, or with several names in one scene, is ignored. If scenes differ, the latest name
    counts: somebody moved the tag. Objects that a person named get no suggestion."""
    borne = {obj.id: tags_of(obj.reads) for obj in objects}
    count = Counter(tag for tags in borne.values() for tag in tags)
    names: dict[int, NameFromScene] = {}
    for obj in objects:
        for tag, here in borne[obj.id].items() if obj.source != "person" else ():
            if count[tag] > 1 or (bearer := _last_named(tag, known)) is None:
                continue
            probability = _STAYS * here * dict(bearer.tags)[tag]
            if obj.id not in names or probability > names[obj.id].probability:
                names[obj.id] = NameFromScene(bearer.name, probability, bearer.scene_id, TAG_SOURCE)
    return names


def _last_named(tag: str, known: Sequence[KnownObject]) -> KnownObject | None:
    """The object that last bore a tag; None if its name is ambiguous."""
    bearing = [obj for obj in known if tag in dict(obj.tags)]
    there = [obj for obj in bearing if obj.scene_id == bearing[0].scene_id]
    return there[0] if len({label_key(obj.name) for obj in there}) == 1 else None
