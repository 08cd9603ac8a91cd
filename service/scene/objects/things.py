"""Queries and edits the things of a scene.

Gaussians belong to things, and names too, so naming a thing changes one table row: instant and exact.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.artefact.reads import bounded_reads
from fastsplat.service.scene.artefact.scene import Evidence, Parts, Scene, SceneT, Thing, ThingGroup, Things
from fastsplat.service.scene.objects.label_evidence import evidence_of, posterior, rows_of
from fastsplat_contract.codec.unseen_characters import check_seen
from fastsplat_contract.errors import InvalidInputError, NotFoundError

MAX_NAME_CHARS = 200

MAX_THING_ID = 65535
"""Membership stores ids in 16 bits."""


def thing_rows(things: Things) -> NDArray[np.int32]:
    """Returns each Gaussian's most probable thing id, int32 [G], 0 for none."""
    return posterior(things.membership, len(things.table) + 1).classes


def part_rows(things: Things) -> NDArray[np.int32]:
    """Returns each Gaussian's most probable part id, int32 [G], 0 for none."""
    if things.parts is None:
        return np.zeros(len(things.membership), np.int32)
    return posterior(things.parts.membership, len(things.parts.table) + 1).classes


def thing_count(things: Things) -> int:
    """Counts things that own Gaussians, except surfaces such as floors and walls."""
    here = set(np.unique(thing_rows(things)).tolist())
    return sum(thing.id in here and not thing.surface for thing in things.table)


def next_thing_id(things: Things) -> int:
    """Returns the id for the next thing to be added."""
    used = [*(thing.id for thing in things.everything), *(group.id for group in things.groups)]
    return max(things.next_id, max(used, default=0) + 1)


def thing_of(things: Things, thing_id: int) -> Thing:
    """Returns the thing with this id.

    Raises:
        NotFoundError: no thing has it.
    """
    for thing in things.table:
        if thing.id == thing_id:
            return thing
    raise NotFoundError(
        f"there is no thing {str(thing_id)[:40]} in this scene", field="thing_id", hint="List the scene's things."
    )


def merge_things(scene: Scene, thing_ids: Sequence[int]) -> Scene:
    """Merges things under the id and name of the first.

    It gets the parts and reads of all, and their places in groups that keep two members.

    Raises:
        NotFoundError: no such thing, or a scene without things.
        InvalidInputError: fewer than two different things.
    """
    things = _things_of(scene)
    first, *others = (thing_of(things, thing_id).id for thing_id in dict.fromkeys(thing_ids))
    if not others:
        raise InvalidInputError(f"{len(thing_ids)} thing to merge", field="thing_ids", hint="Name two or more.")
    reads = bounded_reads(read for each in (first, *others) for read in thing_of(things, each).reads)
    merged = _relabeled(things, others, first)
    table = tuple(replace(thing, reads=reads) if thing.id == first else thing for thing in merged.table)
    return replace(scene, things=replace(merged, table=table))


def discard_thing(scene: SceneT, thing_id: int) -> SceneT:
    """Removes a thing and its parts, or a part.

    A thing's Gaussians stay without an owner, a part's stay with its thing. A group left with one member goes as well.

    Raises:
        NotFoundError: no such thing, or a scene without things.
    """
    things = _things_of(scene)
    parts = () if things.parts is None else things.parts.table
    gone = [part.id for part in parts if thing_id in (part.id, part.parent)]
    if gone:
        things = _without_parts(things, gone)
    if thing_id in gone:
        return replace(scene, things=things)
    return replace(scene, things=_relabeled(things, [thing_of(things, thing_id).id], 0))


def things_of_rows(things: Things | None, rows: NDArray[np.integer]) -> Things | None:
    """Selects the membership of `rows` in that order, repetitions allowed; keeps all ids."""
    if things is None:
        return None
    parts = things.parts
    if parts is not None:
        parts = replace(parts, membership=rows_of(parts.membership, rows))
    return replace(things, membership=rows_of(things.membership, rows), parts=parts)


def with_rows_of_no_part(parts: Parts, gaussians: int) -> Parts:
    """Extends the membership to `gaussians` rows; the new ones have no part."""
    starts = parts.membership.starts
    more = np.full(gaussians - len(parts.membership), starts[-1])
    return replace(parts, membership=replace(parts.membership, starts=np.append(starts, more)))


def _relabeled(things: Things, before: Sequence[int], after: int) -> Things:
    """Hands the Gaussians, parts and groups of `before` to `after`; 0 for none."""
    table = tuple(thing for thing in things.table if thing.id not in before)
    parts = things.parts
    if parts is not None:
        own = tuple(replace(part, parent=after) if part.parent in before else part for part in parts.table)
        parts = replace(parts, table=own)
    membership = _renamed(things.membership, before, after)
    groups = _regrouped(things.groups, before, after)
    return replace(
        things, table=table, membership=membership, next_id=next_thing_id(things), parts=parts, groups=groups
    )


def _regrouped(groups: Sequence[ThingGroup], before: Sequence[int], after: int) -> tuple[ThingGroup, ...]:
    """Replaces `before` by `after` (0: nothing) in groups; drops duplicates and singletons."""
    kept: dict[tuple[int, ...], ThingGroup] = {}
    for group in groups:
        members = tuple(sorted({after if each in before else each for each in group.members} - {0}))
        if len(members) >= 2:
            kept.setdefault(members, replace(group, members=members))
    return tuple(kept.values())


def _without_parts(things: Things, gone: Sequence[int]) -> Things:
    assert things.parts is not None
    table = tuple(part for part in things.parts.table if part.id not in gone)
    parts = Parts(table, _renamed(things.parts.membership, gone, 0)) if table else None
    return replace(things, parts=parts, next_id=next_thing_id(things))


def _renamed(membership: Evidence, before: Sequence[int], after: int) -> Evidence:
    rows = np.repeat(np.arange(len(membership)), np.diff(membership.starts))
    labels = np.where(np.isin(membership.labels, before), after, membership.labels)
    return evidence_of(rows, labels, membership.counts, len(membership))


def _things_of(scene: Scene) -> Things:
    if scene.things is None:
        raise NotFoundError(
            "this scene has no things", field="things", hint="Train it with FASTSPLAT_DISCOVERY__THINGS=auto, or on."
        )
    return scene.things


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
            hint="Name what the thing is; to take a name away, unname the thing.",
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
