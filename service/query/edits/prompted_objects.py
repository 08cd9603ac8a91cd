"""Edits that make an object from a prompt: split one, or add one."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.edits.object_edits import check_no_parts, check_seen, edited_objects, with_label
from fastsplat.service.query.objects.names.look_alikes import with_look_alikes
from fastsplat.service.query.objects.solid_gaussians import masses
from fastsplat.service.scene.artefact.scene import Objects, Scene
from fastsplat.service.scene.gaussians.connectivity import components
from fastsplat.service.scene.objects.new_objects import with_new_object
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.messages.scenes import Edit

if TYPE_CHECKING:
    from fastsplat.service.query.scene_index import SceneIndex

_REST = 0.02
"""Least share of an object in the largest component of a split's rest."""
_SAME = 0.9
"""An added object exists already if its IoU with another reaches this."""
_MOST = 0.5
"""Share of an object from which an added piece takes over its name."""


def split_object(index: SceneIndex, edit: Edit) -> int:
    """Id of the one whole object that an edit splits, else raises InvalidInputError."""
    ids = edited_objects(index, edit)
    check_no_parts(index.objects.table, ids)
    if len(ids) != 1:
        raise InvalidInputError(
            f"{len(ids)} objects to split", field="object_ids", limit="1 object", hint="Split one object in each edit."
        )
    return ids[0]


def make_prompted_object(
    index: SceneIndex, edit: Edit, piece: NDArray[np.int64], seen: Objects | None, before: Objects
) -> Scene:
    """Applies a `split` or an `add`; labels become the objects' names.

    Args:
        piece: int64 [K]: the Gaussians that the prompt shows; for a split, all within the object.
        seen: the objects that the editor has looked at; None: unknown.
        before: the objects before the request that the edit is part of.

    Raises:
        NotFoundError: no such object or label here.
        InvalidInputError: the piece is empty or the whole object; the object to add exists; an invalid name.
        LimitExceededError, ConflictError: see `edit_objects` and `with_new_object`.
    """
    owner = index.objects.owner
    weights = np.minimum(masses(index.scene.gaussians.log_scales, index.scene.gaussians.logit_opacities), 1e30)
    whole = np.bincount(owner, weights).astype(np.float64)
    taken = np.bincount(owner[piece], weights[piece], len(whole)).astype(np.float64)
    if not len(piece):
        raise InvalidInputError(
            "what the picture shows there has no Gaussians of its own",
            field="prompt",
            limit="at least 1 Gaussian",
            hint="Prompt in a view that shows the object larger, or send a box around it.",
        )
    if edit.action == "split":
        object_id = split_object(index, edit)
        rest = np.setdiff1d(np.flatnonzero(owner == object_id), piece)
        parts = np.bincount(components(index.scene.gaussians, rest), weights[rest])
        if parts.max(initial=0) < _REST * whole[object_id]:
            raise InvalidInputError(
                f"what the picture shows there is all of object {object_id}",
                field="prompt",
                limit=f"a rest of at least {_REST:.0%} of the object in one part",
                hint="Send pixels of the rest as background, or a box around the piece.",
            )
        check_seen((object_id,), edit.name, seen, before)
    else:
        _check_missing(edit, taken, whole)
        losers = np.flatnonzero(taken[1:] >= _MOST * np.maximum(whole[1:], 1e-300)) + 1
        check_seen([object_id for object_id in losers.tolist() if taken[object_id]], edit.name, seen, before)
    for field in ("aliases", "kinds"):
        if getattr(edit, field) and edit.name is None:
            raise InvalidInputError(f"{field} without a name", field=field, hint="Send a name, or leave them out.")
    scene, label = index.objects.scene, ""
    if edit.name is not None:
        scene, label = with_label(index, scene, edit.name, edit.aliases, edit.kinds)
    scene, new_id = with_new_object(scene, piece)
    if not label:
        return scene
    *objects, new = scene.objects.table
    named = replace(new, name=label, source="person", probability=1.0)
    return with_look_alikes(replace(scene, objects=replace(scene.objects, table=(*objects, named))), (new_id,))


def _check_missing(edit: Edit, taken: NDArray[np.float64], whole: NDArray[np.float64]) -> None:
    if edit.object_ids or edit.label is not None:
        raise InvalidInputError(
            "add takes no object or label", field="object_ids", hint="To cut a piece out of an object, split it."
        )
    same = taken[1:] / np.maximum(whole[1:] + taken.sum() - taken[1:], 1e-300)
    if len(same) and same.max() >= _SAME:
        object_id = int(same.argmax()) + 1
        raise InvalidInputError(
            f"what the picture shows there is object {object_id} already",
            field="prompt",
            limit=f"an overlap with every object below {_SAME:.0%}",
            hint="Name that object, or split it.",
        )
