"""Edits that make a thing from a prompt: split one, or add one."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.edits.thing_edits import check_no_parts, check_seen, edited_things, with_label
from fastsplat.service.query.things.names.look_alikes import with_look_alikes
from fastsplat.service.query.things.solid_gaussians import masses
from fastsplat.service.scene.artefact.scene import Scene, Things
from fastsplat.service.scene.gaussians.connectivity import components
from fastsplat.service.scene.objects.new_things import with_new_thing
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.messages.scenes import Edit

if TYPE_CHECKING:
    from fastsplat.service.query.scene_index import SceneIndex

_REST = 0.02
"""Least share of a thing in the largest component of a split's rest."""
_SAME = 0.9
"""An added thing exists already if its IoU with another reaches this."""
_MOST = 0.5
"""Share of a thing from which an added piece takes over its name."""


def split_thing(index: SceneIndex, edit: Edit) -> int:
    """Id of the one whole thing that an edit splits, else raises InvalidInputError."""
    ids = edited_things(index, edit)
    check_no_parts(index.things.table, ids)
    if len(ids) != 1:
        raise InvalidInputError(
            f"{len(ids)} things to split", field="thing_ids", limit="1 thing", hint="Split one thing in each edit."
        )
    return ids[0]


def make_prompted_thing(
    index: SceneIndex, edit: Edit, piece: NDArray[np.int64], seen: Things | None, before: Things
) -> Scene:
    """Applies a `split` or an `add`; labels become the things' names.

    Args:
        piece: int64 [K]: the Gaussians that the prompt shows; for a split, all within the thing.
        seen: the things that the editor has looked at; None: unknown.
        before: the things before the request that the edit is part of.

    Raises:
        NotFoundError: no such thing or label here.
        InvalidInputError: the piece is empty or the whole thing; the thing to add exists; an invalid name.
        LimitExceededError, ConflictError: see `edit_things` and `with_new_thing`.
    """
    owner = index.things.owner
    weights = np.minimum(masses(index.scene.gaussians.log_scales, index.scene.gaussians.logit_opacities), 1e30)
    whole = np.bincount(owner, weights).astype(np.float64)
    taken = np.bincount(owner[piece], weights[piece], len(whole)).astype(np.float64)
    if not len(piece):
        raise InvalidInputError(
            "what the picture shows there has no Gaussians of its own",
            field="prompt",
            limit="at least 1 Gaussian",
            hint="Prompt in a view that shows the thing larger, or send a box around it.",
        )
    if edit.action == "split":
        thing_id = split_thing(index, edit)
        rest = np.setdiff1d(np.flatnonzero(owner == thing_id), piece)
        parts = np.bincount(components(index.scene.gaussians, rest), weights[rest])
        if parts.max(initial=0) < _REST * whole[thing_id]:
            raise InvalidInputError(
                f"what the picture shows there is all of thing {thing_id}",
                field="prompt",
                limit=f"a rest of at least {_REST:.0%} of the thing in one part",
                hint="Send pixels of the rest as background, or a box around the piece.",
            )
        check_seen((thing_id,), edit.name, seen, before)
    else:
        _check_missing(edit, taken, whole)
        losers = np.flatnonzero(taken[1:] >= _MOST * np.maximum(whole[1:], 1e-300)) + 1
        check_seen([thing_id for thing_id in losers.tolist() if taken[thing_id]], edit.name, seen, before)
    for field in ("aliases", "kinds"):
        if getattr(edit, field) and edit.name is None:
            raise InvalidInputError(f"{field} without a name", field=field, hint="Send a name, or leave them out.")
    scene, label = index.things.scene, ""
    if edit.name is not None:
        scene, label = with_label(index, scene, edit.name, edit.aliases, edit.kinds)
    scene, new_id = with_new_thing(scene, piece)
    if not label:
        return scene
    *others, new = scene.things.table
    named = replace(new, name=label, source="person", probability=1.0)
    return with_look_alikes(replace(scene, things=replace(scene.things, table=(*others, named))), (new_id,))


def _check_missing(edit: Edit, taken: NDArray[np.float64], whole: NDArray[np.float64]) -> None:
    if edit.thing_ids or edit.label is not None:
        raise InvalidInputError(
            "add takes no thing or label", field="thing_ids", hint="To cut a piece out of a thing, split it."
        )
    same = taken[1:] / np.maximum(whole[1:] + taken.sum() - taken[1:], 1e-300)
    if len(same) and same.max() >= _SAME:
        thing_id = int(same.argmax()) + 1
        raise InvalidInputError(
            f"what the picture shows there is thing {thing_id} already",
            field="prompt",
            limit=f"an overlap with every thing below {_SAME:.0%}",
            hint="Name that thing, or split it.",
        )
