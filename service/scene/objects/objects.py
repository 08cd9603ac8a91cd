"""Queries and edits the objects of a scene.

Gaussians belong to objects, and names too, so naming an object changes one table row: instant and exact.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.artefact.reads import bounded_reads
from fastsplat.service.scene.artefact.scene import Evidence, Object, ObjectGroup, Objects, Parts, Scene, SceneT
from fastsplat.service.scene.objects.label_evidence import evidence_of, posterior, rows_of, with_unseen
from fastsplat_contract.codec.unseen_characters import check_seen
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, NotFoundError

MAX_NAME_CHARS = 200

MAX_OBJECT_ID = 65535
"""Membership stores ids in 16 bits."""


def object_rows(objects: Objects) -> NDArray[np.int32]:
    """Returns each Gaussian's most probable object id, int32 [G], 0 for none."""
    return posterior(objects.membership, len(objects.table) + 1).classes


def part_rows(objects: Objects) -> NDArray[np.int32]:
    """Returns each Gaussian's most probable part id, int32 [G], 0 for none."""
    if objects.parts is None:
        return np.zeros(len(objects.membership), np.int32)
    return posterior(objects.parts.membership, len(objects.parts.table) + 1).classes


def object_count(objects: Objects) -> int:
    """Counts objects that own Gaussians, except surfaces such as floors and walls."""
    here = set(np.unique(object_rows(objects)).tolist())
    return sum(obj.id in here and not obj.surface for obj in objects.table)


def next_object_id(objects: Objects) -> int:
    """Returns the id for the next object to be added."""
    used = [*(obj.id for obj in objects.everything), *(group.id for group in objects.groups)]
    return max(objects.next_id, max(used, default=0) + 1)


def new_object_ids(objects: Objects, count: int) -> range:
    """Returns the ids for the next `count` objects to be added.

    Raises:
        LimitExceededError: there are not so many ids.
    """
    first = next_object_id(objects)
    if first + count - 1 > MAX_OBJECT_ID:
        raise LimitExceededError(
            f"{count} more objects", field="object_ids", limit=f"ids up to {MAX_OBJECT_ID}", hint="Merge some first."
        )
    return range(first, first + count)


def object_of(objects: Objects, object_id: int) -> Object:
    """Returns the object with this id.

    Raises:
        NotFoundError: no object has it.
    """
    for obj in objects.table:
        if obj.id == object_id:
            return obj
    raise NotFoundError(
        f"there is no object {str(object_id)[:40]} in this scene", field="object_id", hint="List the scene's objects."
    )


def merge_objects(scene: Scene, object_ids: Sequence[int]) -> Scene:
    """Merges objects under the id and name of the first.

    It gets the parts and reads of all, and their places in groups that keep two members.

    Raises:
        NotFoundError: no such object, or a scene without objects.
        InvalidInputError: fewer than two different objects.
    """
    objects = _objects_of(scene)
    first, *other_ids = (object_of(objects, object_id).id for object_id in dict.fromkeys(object_ids))
    if not other_ids:
        raise InvalidInputError(f"{len(object_ids)} object to merge", field="object_ids", hint="Name two or more.")
    reads = bounded_reads(read for object_id in (first, *other_ids) for read in object_of(objects, object_id).reads)
    merged = _relabeled(objects, other_ids, first)
    table = tuple(replace(obj, reads=reads) if obj.id == first else obj for obj in merged.table)
    return replace(scene, objects=replace(merged, table=table))


def discard_object(scene: SceneT, object_id: int) -> SceneT:
    """Removes an object and its parts, or a part.

    An object's Gaussians stay without an owner, a part's stay with its object. A group left with one member goes as
    well.

    Raises:
        NotFoundError: no such object, or a scene without objects.
    """
    objects = _objects_of(scene)
    parts = () if objects.parts is None else objects.parts.table
    gone = [part.id for part in parts if object_id in (part.id, part.parent)]
    if gone:
        objects = _without_parts(objects, gone)
    if object_id in gone:
        return replace(scene, objects=objects)
    return replace(scene, objects=_relabeled(objects, [object_of(objects, object_id).id], 0))


def objects_of_rows(objects: Objects | None, rows: NDArray[np.integer]) -> Objects | None:
    """Selects the membership of `rows` in that order, repetitions allowed; keeps all ids."""
    if objects is None:
        return None
    parts = objects.parts
    if parts is not None:
        parts = replace(parts, membership=rows_of(parts.membership, rows))
    return replace(objects, membership=rows_of(objects.membership, rows), parts=parts)


def with_rows_of_no_part(parts: Parts, gaussians: int) -> Parts:
    """Extends the membership to `gaussians` rows; the new ones have no part."""
    return replace(parts, membership=with_unseen(parts.membership, gaussians - len(parts.membership)))


def _relabeled(objects: Objects, before: Sequence[int], after: int) -> Objects:
    """Hands the Gaussians, parts and groups of `before` to `after`; 0 for none."""
    table = tuple(obj for obj in objects.table if obj.id not in before)
    parts = objects.parts
    if parts is not None:
        new_parts = tuple(replace(part, parent=after) if part.parent in before else part for part in parts.table)
        parts = replace(parts, table=new_parts)
    membership = _renamed(objects.membership, before, after)
    groups = _regrouped(objects.groups, before, after)
    return replace(
        objects, table=table, membership=membership, next_id=next_object_id(objects), parts=parts, groups=groups
    )


def _regrouped(groups: Sequence[ObjectGroup], before: Sequence[int], after: int) -> tuple[ObjectGroup, ...]:
    """Replaces `before` by `after` (0: nothing) in groups; drops duplicates and singletons."""
    by_members: dict[tuple[int, ...], ObjectGroup] = {}
    for group in groups:
        members = tuple(sorted({after if member in before else member for member in group.members} - {0}))
        if len(members) >= 2:
            by_members.setdefault(members, replace(group, members=members))
    return tuple(by_members.values())


def _without_parts(objects: Objects, gone: Sequence[int]) -> Objects:
    assert objects.parts is not None
    table = tuple(part for part in objects.parts.table if part.id not in gone)
    parts = Parts(table, _renamed(objects.parts.membership, gone, 0)) if table else None
    return replace(objects, parts=parts, next_id=next_object_id(objects))


def _renamed(membership: Evidence, before: Sequence[int], after: int) -> Evidence:
    rows = np.repeat(np.arange(len(membership)), np.diff(membership.starts))
    labels = np.where(np.isin(membership.labels, before), after, membership.labels)
    return evidence_of(rows, labels, membership.counts, len(membership))


def _objects_of(scene: Scene) -> Objects:
    if scene.objects is None:
        raise NotFoundError(
            "this scene has no objects", field="objects", hint="Train it with FASTSPLAT_DISCOVERY__OBJECTS=auto, or on."
        )
    return scene.objects


def checked_name(name: str, field: str) -> str:
    """Strips and validates a name.

    Raises:
        InvalidInputError: about `field`: longer than `MAX_NAME_CHARS`, without a letter, digit or symbol of any script,
            or not on one line.
    """
    text = name.strip()
    if not any(unicodedata.category(character)[0] in "LNS" for character in text):
        raise InvalidInputError(
            f"a name of {len(text)} characters without a letter, a digit or a symbol",
            field=field,
            limit=f"1 to {MAX_NAME_CHARS} characters",
            hint="Name what the object is; to take a name away, unname the object.",
        )
    if len(text) > MAX_NAME_CHARS:
        raise InvalidInputError(
            f"a name of {len(text)} characters",
            field=field,
            limit=f"1 to {MAX_NAME_CHARS} characters",
            hint="Shorten it.",
        )
    check_seen(text, field)
    return text
