"""Creates an object from Gaussians that belonged to other objects or to none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.scene.artefact.scene import Object, ObjectScene
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of, without_rows
from fastsplat.service.scene.objects.objects import new_object_ids, object_rows

_SURE_PX = 16  # membership of a Gaussian without evidence, pixels


def with_new_object(scene: ObjectScene, rows: NDArray[np.integer]) -> tuple[ObjectScene, int]:
    """Assigns the Gaussians `rows` to a new unnamed object; returns the scene and its id.

    In each Gaussian's membership the new object replaces its most probable owner, with one count more so that it wins
    ties. Parts of others lose these Gaussians. The new object joins the groups that all its Gaussians were in. An
    object left without Gaussians stays in the table, but is no longer present.

    Raises:
        LimitExceededError: no id is left.
    """
    objects = scene.objects
    assert len(rows)
    (new_id,) = new_object_ids(objects, 1)
    membership, owner = objects.membership, object_rows(objects)
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
    parts = (
        None
        if objects.parts is None
        else replace(objects.parts, membership=without_rows(objects.parts.membership, taken))
    )
    table = (*objects.table, Object(new_id))
    groups = tuple(
        replace(group, members=(*group.members, new_id)) if np.isin(owner[rows], group.members).all() else group
        for group in objects.groups
    )
    new_objects = replace(objects, table=table, membership=evidence, next_id=new_id + 1, parts=parts, groups=groups)
    return replace(scene, objects=new_objects), new_id
