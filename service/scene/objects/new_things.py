"""Creates a thing from Gaussians that belonged to other things or to none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.artefact.scene import Parts, Thing, ThingScene
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of, without_rows
from fastsplat.service.scene.objects.things import MAX_THING_ID, next_thing_id, thing_rows
from fastsplat_contract.errors import LimitExceededError

_SURE_PX = 16  # membership of a Gaussian without evidence, pixels


def with_new_thing(scene: ThingScene, rows: NDArray[np.integer]) -> tuple[ThingScene, int]:
    """Assigns the Gaussians `rows` to a new unnamed thing; returns the scene and its id.

    In each Gaussian's membership the new thing replaces its most probable owner, with one count more so that it wins
    ties. Parts of others lose these Gaussians. The new thing joins the groups that all its Gaussians were in. A thing
    left without Gaussians stays in the table, but is no longer present.

    Raises:
        LimitExceededError: no id is left.
    """
    things = scene.things
    assert len(rows)
    new_id = next_thing_id(things)
    if new_id > MAX_THING_ID:
        raise LimitExceededError(
            "one more thing", field="thing_ids", limit=f"ids up to {MAX_THING_ID}", hint="Merge some things first."
        )
    membership, owner = things.membership, thing_rows(things)
    taken = np.zeros(len(membership), np.bool_)
    taken[rows] = True
    entries = np.repeat(np.arange(len(membership)), np.diff(membership.starts))
    replaced = taken[entries] & (membership.labels == owner[entries])
    bare = taken.copy()
    bare[entries[replaced]] = False
    unseen = np.flatnonzero(bare)
    evidence = evidence_of(
        np.concatenate([entries, unseen]),
        np.concatenate([np.where(replaced, new_id, membership.labels.astype(np.int64)), np.full(len(unseen), new_id)]),
        np.concatenate([membership.counts + replaced, np.full(len(unseen), _SURE_PX * UNIT, np.int64)]),
        len(membership),
    )
    parts = None if things.parts is None else _without_rows(things.parts, taken)
    table = (*things.table, Thing(new_id))
    groups = tuple(
        replace(group, members=(*group.members, new_id)) if np.isin(owner[rows], group.members).all() else group
        for group in things.groups
    )
    made = replace(things, table=table, membership=evidence, next_id=new_id + 1, parts=parts, groups=groups)
    return replace(scene, things=made), new_id


def _without_rows(parts: Parts, gone: NDArray[np.bool_]) -> Parts:
    return replace(parts, membership=without_rows(parts.membership, gone))
