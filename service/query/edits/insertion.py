"""Insertion of objects from another scene."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fastsplat.service.query.edits.edited_rows import edited_rows
from fastsplat.service.query.edits.gaussian_edits import motion_of, moved_gaussians
from fastsplat.service.query.edits.object_edits import check_no_parts, edited_objects, with_label
from fastsplat.service.scene.artefact.scene import Evidence, Scene
from fastsplat.service.scene.gaussians.scene_rows import appended_gaussians, gaussians_of_rows
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of, with_unseen
from fastsplat.service.scene.objects.objects import new_object_ids, object_of, with_rows_of_no_part
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.messages.scenes import Edit

if TYPE_CHECKING:
    from fastsplat.service.query.scene_index import SceneIndex

_SURE_PX = 16
"""Membership of an inserted Gaussian in its object, pixels: certain."""


def insert_objects(index: SceneIndex, source: SceneIndex, edit: Edit) -> Scene:
    """Inserts objects of another scene by a rigid motion; labels become the objects' names.

    The Gaussians of the objects and those they enclose (see `edited_rows`) are appended. The objects get new ids and
    keep their names, name sources and suggestions, but not their parts. Colors keep this scene's SH degree. Lengths are
    copied as numbers, without conversion.

    Raises:
        NotFoundError: no such label or object there.
        InvalidInputError: not exactly one of label and objects; a part; one scene is metric and the other has no unit.
        LimitExceededError: more objects than there are ids.
    """
    here = index.objects.scene
    if source.scene.scale != here.scale:
        raise InvalidInputError(
            f"an object of a scene whose scale is {source.scene.scale} in one whose scale is {here.scale}",
            field="source",
            hint="Insert from a scene of the same scale; lengths would mean nothing.",
        )
    ids = edited_objects(source, edit)
    check_no_parts(source.objects.table, ids)
    source_edit = replace(edit, label=None, object_ids=ids)
    rows = edited_rows(source, source_edit)
    here_ids = new_object_ids(here.objects, len(ids))
    scene, objects = here, []
    for here_id, object_id in zip(here_ids, ids, strict=True):
        obj = object_of(source.objects.table, object_id)
        name = obj.name
        if name:
            scene, name = with_label(index, scene, name)
        objects.append(replace(obj, id=here_id, name=name, proposed_in=(), missed_in=()))  # by other cameras
    owner = source.objects.owner[rows]
    new_ids = np.zeros(max(ids) + 1, np.int64)
    new_ids[list(ids)] = here_ids
    # Enclosed Gaussians of no inserted object go with the first.
    inside = np.where(np.isin(owner, ids), new_ids[np.minimum(owner, max(ids))], here_ids[0])
    part = moved_gaussians(gaussians_of_rows(source.scene.gaussians, rows), motion_of(edit))
    return replace(
        scene,
        gaussians=appended_gaussians(scene.gaussians, part),
        evidence=None if scene.evidence is None else with_unseen(scene.evidence, len(rows)),
        objects=replace(
            scene.objects,
            table=(*scene.objects.table, *objects),
            membership=_with_members(scene.objects.membership, inside),
            next_id=here_ids.stop,
            parts=None
            if scene.objects.parts is None
            else with_rows_of_no_part(scene.objects.parts, len(scene.gaussians) + len(rows)),
        ),
    )


def _with_members(membership: Evidence, owner: np.ndarray) -> Evidence:
    longer = with_unseen(membership, len(owner))
    rows = np.repeat(np.arange(len(longer)), np.diff(longer.starts))
    added = np.arange(len(membership), len(longer))
    return evidence_of(
        np.concatenate([rows, added]),
        np.concatenate([longer.labels.astype(np.int64), owner]),
        np.concatenate([longer.counts, np.full(len(owner), _SURE_PX * UNIT, np.int64)]),
        len(longer),
    )
