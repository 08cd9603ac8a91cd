"""Edits of things: name, unname, merge, discard.

No Gaussian changes and nothing is trained: afterwards the scene's labels are the names of its things."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.query.edits.edited_rows import edited_label
from fastsplat.service.query.things.names.look_alikes import with_look_alikes
from fastsplat.service.scene.artefact.scene import Scene, SceneT, SemanticHead, Thing, Things, ThingScene
from fastsplat.service.scene.objects.things import checked_name, discard_thing, merge_things
from fastsplat_contract.errors import ConflictError, InvalidInputError, LimitExceededError, NotFoundError
from fastsplat_contract.messages.scenes import Edit

if TYPE_CHECKING:
    from fastsplat.service.query.scene_index import SceneIndex

MAX_ALIASES = 20
"""Per name and edit."""
_NEVER = -1e4
"""Logit of a label that no code has learned."""


def edit_things(index: SceneIndex, edit: Edit, seen: Things | None, before: Things) -> Scene:
    """Applies `name`, `unname`, `merge` or `discard`; arguments as `apply_edit`.

    Afterwards the scene's labels are its things' names.

    Raises:
        NotFoundError: no such thing or label here.
        InvalidInputError: an invalid, missing or superfluous name or alias; too few things to merge.
        LimitExceededError: too many aliases.
        ConflictError: as `check_seen`, or an alias is another label's name.
    """
    actions: dict[str, Callable[[SceneIndex, ThingScene, tuple[int, ...], Edit], Scene]] = {
        "name": _name,
        "unname": _unname,
        "merge": _merge,
        "discard": _discard,
    }
    if edit.action == "name" and edit.name is None:
        raise InvalidInputError("name needs a name", field="name", hint="See the edit's fields.")
    ids = edited_things(index, edit)
    check_seen(ids[1:] if edit.action == "merge" else ids, edit.name, seen, before)
    return actions[edit.action](index, index.things.scene, ids, edit)


def edited_things(index: SceneIndex, edit: Edit) -> tuple[int, ...]:
    """Ids of the things an edit names, or that bear its label; raises as `edited_label`."""
    label_id, things, dictionary = edited_label(index, edit), index.things, index.scene.dictionary
    if not label_id:
        return tuple(dict.fromkeys(edit.thing_ids))
    everything = (*things.present, *things.present_parts)
    ids = tuple(thing.id for thing in everything if thing.name and dictionary.id_of(thing.name) == label_id)
    if not ids:
        told = f"nothing in this version bears the label {str(edit.label)[:80]!r}"
        raise NotFoundError(told, field="label", hint="List the scene's things.")
    return ids


def check_seen(ids: Sequence[int], name: str | None, seen: Things | None, before: Things) -> None:
    """Raises ConflictError if a name that the editor has not seen would be undone.

    Only names by people since `seen` (None: unknown) count, unless they equal the new `name`."""
    known = {} if seen is None else {thing.id: thing.name for thing in seen.everything}
    now = {thing.id: thing for thing in before.everything}
    for thing_id in ids:
        thing = now.get(thing_id)
        if thing is not None and thing.source == "person" and thing.name not in (name, known.get(thing_id)):
            raise ConflictError(
                f"a person has named thing {thing_id} {thing.name!r}",
                field="version",
                hint="Look at the thing as it is now; to replace the name, send the version that you looked at.",
            )


def _name(index: SceneIndex, scene: ThingScene, ids: tuple[int, ...], edit: Edit) -> Scene:
    scene, label = with_label(index, scene, edit.name or "", edit.aliases, edit.kinds)
    named = _changed(scene, ids, lambda thing: replace(thing, name=label, source="person", probability=1.0))
    return with_look_alikes(named, ids)


def _unname(index: SceneIndex, scene: ThingScene, ids: tuple[int, ...], edit: Edit) -> Scene:
    return _changed(scene, ids, lambda thing: replace(thing, name="", source=None, probability=0.0))


def _merge(index: SceneIndex, scene: ThingScene, ids: tuple[int, ...], edit: Edit) -> Scene:
    check_no_parts(index.things.table, ids)
    return merge_things(scene, ids)


def _discard(index: SceneIndex, scene: ThingScene, ids: tuple[int, ...], edit: Edit) -> Scene:
    for thing_id in ids:
        if thing_id in {thing.id for thing in scene.things.everything}:
            scene = discard_thing(scene, thing_id)  # a part may have gone with its thing
    return scene


def check_no_parts(things: Things, thing_ids: Sequence[int]) -> None:
    """Raises InvalidInputError if an id is a part's."""
    parents = {} if things.parts is None else {part.id: part.parent for part in things.parts.table}
    for number, thing_id in enumerate(thing_ids):
        if thing_id in parents:
            raise InvalidInputError(
                f"{thing_id} is a part of thing {parents[thing_id]}",
                field=f"thing_ids[{number}]",
                hint="Send ids of whole things.",
            )


def _changed(scene: ThingScene, ids: Sequence[int], change: Callable[[Thing], Thing]) -> ThingScene:
    chosen = set(ids)
    table = tuple(change(thing) if thing.id in chosen else thing for thing in scene.things.table)
    parts = scene.things.parts
    if parts is not None and any(part.id in chosen for part in parts.table):
        parts = replace(parts, table=tuple(change(part) if part.id in chosen else part for part in parts.table))
    return replace(scene, things=replace(scene.things, table=table, parts=parts))


def with_label(
    index: SceneIndex, scene: SceneT, name: str, aliases: Sequence[str] = (), kinds: Sequence[str] = ()
) -> tuple[SceneT, str]:
    """Adds a dictionary entry with aliases and returns its label; errors as `edit_things`.

    Case, plural and spelling variants of a known name are that name. A kind becomes an alias of the form name + kind
    ("Oskar teddy bear"), found like any name with that ending; so two names may be of one kind."""
    text = checked_name(name, "name")
    others: list[tuple[str, str]] = []
    for field, words in (("aliases", aliases), ("kinds", kinds)):
        if len(words) > MAX_ALIASES:
            raise LimitExceededError(f"{len(words)} {field}", field=field, limit=f"{MAX_ALIASES} {field}")
        own = [(f"{field}[{number}]", checked_name(word, f"{field}[{number}]")) for number, word in enumerate(words)]
        others += [
            (place, word if field == "aliases" else checked_name(f"{text} {word}", place)) for place, word in own
        ]
    entries = list(scene.dictionary.entries)
    label_id = scene.dictionary.id_of(text)
    if label_id is None:
        entries.append(DictionaryEntry(text))
        scene = index.with_label(scene, entries[-1], _grown(scene.head))
    entry = entries[label_id - 1 if label_id else -1]
    for place, alias in others:
        owner = Dictionary(tuple(entries)).id_of(alias)
        if owner is None:
            entry = replace(entry, aliases=(*entry.aliases, alias))
            entries[label_id - 1 if label_id else -1] = entry
        elif entries[owner - 1] is not entry:
            raise ConflictError(
                f"{alias[:80]!r} is a name of the label {entries[owner - 1].label[:80]!r}",
                field=place,
                hint="Leave the alias out, or give the things that other name.",
            )
    return replace(scene, dictionary=Dictionary(tuple(entries))), entry.label


def _grown(head: SemanticHead) -> SemanticHead:
    """Adds a row to W that no code activates."""
    return SemanticHead(
        np.concatenate([head.weight, np.zeros((1, head.weight.shape[1]), np.float32)]),
        np.append(head.bias, np.float32(_NEVER)).astype(np.float32),
    )
