"""An edit of a scene, as every kind of it is asked for, and the Gaussians that it is about."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import expit

from fastsplat.service.query.things.objects import MIN_OPACITY
from fastsplat.service.scene.types import F32
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.places import Alignment, KnownLength, KnownSize
from fastsplat_contract.scenes import EditAction, InsertSource
from fastsplat_contract.thing_prompts import ThingPrompt

if TYPE_CHECKING:
    from fastsplat.service.query.scene_index import SceneIndex

Rows = NDArray[np.int64]

_NEIGHBORS = 12
_ENCLOSED = 0.5
_MARGIN = 0.25


@dataclass(frozen=True)
class Edit:
    """What to do to everything of a label, to one object, or to things.

    Attributes:
        action: what.
        label: a name of the scene's dictionary (as in its hash table: case, plural and aliases do not matter), or None;
            with it everything of that label is meant, objects and specks.
        object_id: `SceneObject.id`, or None.
        things: ids of things, or none; exactly one of label, object_id and things.
        color: RGB 0..1 for `recolor`, the mean color afterwards; None otherwise.
        transform: float64 [4, 4] for `move` and `duplicate`, the rigid motion x' = R x + t in the world frame, scene
            units; None otherwise.
        name, aliases, kinds: for `name`, see `edit_things`.
        source: for `insert`, where the things come from; None otherwise.
        prompt: for `split` and `add`, where the piece or the missing thing is in a picture; None otherwise.
        texts: of versions that looking again made; none for an edit.
        known_lengths, known_sizes: for `scale`; none otherwise.
        alignment: for `align`; None otherwise.
    """

    action: EditAction
    label: str | None = None
    object_id: str | None = None
    color: tuple[float, float, float] | None = None
    transform: NDArray[np.float64] | None = None
    things: tuple[int, ...] = ()
    name: str | None = None
    aliases: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    source: InsertSource | None = None
    prompt: ThingPrompt | None = None
    texts: tuple[str, ...] = ()
    known_lengths: tuple[KnownLength, ...] = ()
    known_sizes: tuple[KnownSize, ...] = ()
    alignment: Alignment | None = None


def edited_rows(index: SceneIndex, edit: Edit) -> Rows:
    """int64 [K], ascending: the Gaussians that an edit is about. Those of the label or object, and those they enclose:
    of whose twelve nearest visible neighbors they have half the opacity or more.

    Raises:
        NotFoundError: no such label, object or thing here.
        InvalidInputError: not exactly one of label, object_id and things.
    """
    rows = _named_rows(index, edit)
    gaussians = index.scene.gaussians
    if not len(rows):
        return rows
    opacities = expit(gaussians.logit_opacities.astype(np.float64))
    finite = np.isfinite(gaussians.means).all(axis=1)
    visible = np.flatnonzero(finite & (opacities >= MIN_OPACITY))
    taken = np.zeros(len(gaussians), dtype=np.bool_)
    taken[rows] = True
    around = gaussians.means[np.intersect1d(rows, visible)]
    if not len(around):
        return rows
    low, high = around.min(axis=0), around.max(axis=0)
    candidates = np.flatnonzero(_within(gaussians.means, low, high) & finite & ~taken)
    margin = _MARGIN * (high - low).max()
    visible = visible[_within(gaussians.means[visible], low - margin, high + margin)]
    count = min(_NEIGHBORS, len(visible))
    near = visible[cKDTree(gaussians.means[visible]).query(gaussians.means[candidates], k=[*range(1, count + 1)])[1]]
    shares = (opacities[near] * taken[near]).sum(axis=1) / opacities[near].sum(axis=1)
    taken[candidates[shares >= _ENCLOSED]] = True
    return np.flatnonzero(taken)


def _within(points: F32, low: F32, high: F32) -> NDArray[np.bool_]:
    return np.asarray(((points >= low) & (points <= high)).all(axis=1))


def _named_rows(index: SceneIndex, edit: Edit) -> Rows:
    if (edit.label is not None) + (edit.object_id is not None) + bool(edit.things) != 1:
        raise InvalidInputError(
            "an edit speaks of a label, of an object or of things",
            field="label",
            hint="Send exactly one of label, object_id and things.",
        )
    if edit.label is not None:
        label_id = index.scene.dictionary.id_of(edit.label)
        if label_id is None:
            raise NotFoundError(
                f"no label {edit.label[:80]!r} in this scene", field="label", hint="List the scene's labels."
            )
        return np.flatnonzero(index.labeled((label_id,)))
    if edit.things:
        index.things.check_all(edit.things)
        things = index.things
        return np.flatnonzero(np.isin(things.owner, edit.things) | np.isin(things.part_owner, edit.things))
    for instance in index.instances:
        if instance.object.id == edit.object_id:
            return instance.rows.astype(np.int64)
    raise NotFoundError(
        f"no object {str(edit.object_id)[:80]!r} in this scene", field="object_id", hint="List the scene's objects."
    )
