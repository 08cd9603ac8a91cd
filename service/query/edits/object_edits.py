"""Edits of objects: name, unname, merge, discard.

No Gaussian changes and nothing is trained: afterwards the scene's labels are the names of its objects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.query.edits.edited_rows import edited_label
from fastsplat.service.query.objects.names.look_alikes import with_look_alikes
from fastsplat.service.scene.artefact.scene import Object, Objects, ObjectScene, Scene, SceneT
from fastsplat.service.scene.objects.objects import checked_name, discard_object, merge_objects
from fastsplat_contract.errors import ConflictError, InvalidInputError, LimitExceededError, NotFoundError
from fastsplat_contract.messages.scenes import Edit

if TYPE_CHECKING:
    from fastsplat.service.query.scene_index import SceneIndex

MAX_ALIASES = 20
"""Per name and edit."""


def edit_objects(index: SceneIndex, edit: Edit, seen: Objects | None, before: Objects) -> Scene:
    """Applies `name`, `unname`, `merge` or `discard`; arguments as `apply_edit`.

    Afterwards the scene's labels are its objects' names.

    Raises:
        NotFoundError: no such object or label here.
        InvalidInputError: an invalid, missing or superfluous name or alias; too few objects to merge.
        LimitExceededError: too many aliases.
        ConflictError: as `check_seen`, or an alias is another label's name.
    """
    actions: dict[str, Callable[[SceneIndex, ObjectScene, tuple[int, ...], Edit], Scene]] = {
        "name": _name,
        "unname": _unname,
        "merge": _merge,
        "discard": _discard,
    }
    if edit.action == "name" and edit.name is None:
        raise InvalidInputError("name needs a name", field="name", hint="See the edit's fields.")
    ids = edited_objects(index, edit)
    check_seen(ids[1:] if edit.action == "merge" else ids, edit.name, seen, before)
    return actions[edit.action](index, index.objects.scene, ids, edit)


def edited_objects(index: SceneIndex, edit: Edit) -> tuple[int, ...]:
    """Ids of the objects an edit names, or that bear its label; raises as `edited_label`."""
    label_id, objects, dictionary = edited_label(index, edit), index.objects, index.scene.dictionary
    if not label_id:
        return tuple(dict.fromkeys(edit.object_ids))
    everything = (*objects.present, *objects.present_parts)
    ids = tuple(obj.id for obj in everything if obj.name and dictionary.id_of(obj.name) == label_id)
    if not ids:
        message = f"nothing in this version bears the label {str(edit.label)[:80]!r}"
        raise NotFoundError(message, field="label", hint="List the scene's objects.")
    return ids


def check_seen(ids: Sequence[int], name: str | None, seen: Objects | None, before: Objects) -> None:
    """Raises ConflictError if a name that the editor has not seen would be undone.

    Only names by people since `seen` (None: unknown) count, unless they equal the new `name`."""
    known = {} if seen is None else {obj.id: obj.name for obj in seen.everything}
    now = {obj.id: obj for obj in before.everything}
    for object_id in ids:
        obj = now.get(object_id)
        if obj is not None and obj.source == "person" and obj.name not in (name, known.get(object_id)):
            raise ConflictError(
                f"a person has named object {object_id} {obj.name!r}",
                field="version",
                hint="Look at the object as it is now; to replace the name, send the version that you looked at.",
            )


def _name(index: SceneIndex, scene: ObjectScene, ids: tuple[int, ...], edit: Edit) -> Scene:
    scene, label = with_label(index, scene, edit.name or "", edit.aliases, edit.kinds)
    named = _changed(scene, ids, lambda obj: replace(obj, name=label, source="person", probability=1.0))
    return with_look_alikes(named, ids)


def _unname(index: SceneIndex, scene: ObjectScene, ids: tuple[int, ...], edit: Edit) -> Scene:
    return _changed(scene, ids, lambda obj: replace(obj, name="", source=None, probability=0.0))


def _merge(index: SceneIndex, scene: ObjectScene, ids: tuple[int, ...], edit: Edit) -> Scene:
    check_no_parts(index.objects.table, ids)
    return merge_objects(scene, ids)


def _discard(index: SceneIndex, scene: ObjectScene, ids: tuple[int, ...], edit: Edit) -> Scene:
    for object_id in ids:
        if object_id in {obj.id for obj in scene.objects.everything}:
            scene = discard_object(scene, object_id)  # a part may have gone with its object
    return scene


def check_no_parts(objects: Objects, object_ids: Sequence[int]) -> None:
    """Raises InvalidInputError if an id is a part's."""
    parents = {} if objects.parts is None else {part.id: part.parent for part in objects.parts.table}
    for number, object_id in enumerate(object_ids):
        if object_id in parents:
            raise InvalidInputError(
                f"{object_id} is a part of object {parents[object_id]}",
                field=f"object_ids[{number}]",
                hint="Send ids of whole objects.",
            )


def _changed(scene: ObjectScene, ids: Sequence[int], change: Callable[[Object], Object]) -> ObjectScene:
    chosen = set(ids)
    table = tuple(change(obj) if obj.id in chosen else obj for obj in scene.objects.table)
    parts = scene.objects.parts
    if parts is not None and any(part.id in chosen for part in parts.table):
        parts = replace(parts, table=tuple(change(part) if part.id in chosen else part for part in parts.table))
    return replace(scene, objects=replace(scene.objects, table=table, parts=parts))


def with_label(
    index: SceneIndex, scene: SceneT, name: str, aliases: Sequence[str] = (), kinds: Sequence[str] = ()
) -> tuple[SceneT, str]:
    """Adds a dictionary entry with aliases and returns its label; errors as `edit_objects`.

    Case, plural and spelling variants of a known name are that name. A kind becomes an alias of the form name + kind
    ("Oskar teddy bear"), found like any name with that ending; so two names may be of one kind."""
    text = checked_name(name, "name")
    alias_words: list[tuple[str, str]] = []
    for field, words in (("aliases", aliases), ("kinds", kinds)):
        if len(words) > MAX_ALIASES:
            raise LimitExceededError(f"{len(words)} {field}", field=field, limit=f"{MAX_ALIASES} {field}")
        pairs = [(f"{field}[{number}]", checked_name(word, f"{field}[{number}]")) for number, word in enumerate(words)]
        alias_words += [
            (place, word if field == "aliases" else checked_name(f"{text} {word}", place)) for place, word in pairs
        ]
    entries = list(scene.dictionary.entries)
    label_id = scene.dictionary.id_of(text)
    if label_id is None:
        entries.append(DictionaryEntry(text))
        scene = index.with_label(scene, entries[-1], scene.head.grown())
    entry = entries[label_id - 1 if label_id else -1]
    for place, alias in alias_words:
        owner = Dictionary(tuple(entries)).id_of(alias)
        if owner is None:
            entry = replace(entry, aliases=(*entry.aliases, alias))
            entries[label_id - 1 if label_id else -1] = entry
        elif entries[owner - 1] is not entry:
            raise ConflictError(
                f"{alias[:80]!r} is a name of the label {entries[owner - 1].label[:80]!r}",
                field=place,
                hint="Leave the alias out, or give the objects that other name.",
            )
    return replace(scene, dictionary=Dictionary(tuple(entries))), entry.label
