"""Edits that people made on a draft of a scene, made again on what takes its place.

Both scenes are of one capture and lie in one world frame, so a thing of the one is that of the other which fills the
same space (`matched_things`). From then on ids are followed edit by edit: a thing that an edit makes here is the one
that the same edit made there. What a prompt showed there is here what lies in the same place; what was inserted there
is taken from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.edits.thing_edits import edited_things
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.scene.objects.label_evidence import seen_pixels
from fastsplat_contract.errors import FastSplatError, NotFoundError
from fastsplat_contract.geometry.places import KnownSize
from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3
from fastsplat_contract.messages.scenes import Edit

_UNMOVED = Pose(Vector3(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
_OVERLAP = 0.25
"""Least share of the space of two things together that both fill, for them to be one. Drafts know a thing by six views'
masks at most, so its rims are not the finished one's; two things that stand side by side share less."""


@dataclass(frozen=True)
class DraftVersion:
    """A version that people made of a draft: by which edits, and what came of them."""

    edits: Sequence[Edit]
    index: SceneIndex


@dataclass(frozen=True)
class CarriedVersion:
    """The same made again.

    Attributes:
        number: of the `DraftVersion`, from 0.
        edits: those that could be made, in the ids of the new scene.
        index: what came of them.
    """

    number: int
    edits: Sequence[Edit]
    index: SceneIndex


@dataclass(frozen=True)
class Carried:
    """What became of edits; `lost`: those that could not be made again, in words."""

    versions: Sequence[CarriedVersion]
    lost: Sequence[str] = field(default_factory=list)


def carry_edits(
    index: SceneIndex, draft: SceneIndex, edited: Sequence[DraftVersion], *, max_gaussians: int | None = None
) -> Carried:
    """The edits of a draft made again on what takes its place, a version for each; one without an edit that can be made
    is left out.

    Args:
        index: of the new scene.
        draft: of the draft as its job made it.
        edited: what people made of it, each of the one before.
        max_gaussians: as for `apply_edit`.
    """
    ids = matched_things(draft, index)
    versions: list[CarriedVersion] = []
    lost: list[str] = []
    before = draft
    for number, version in enumerate(edited):
        made: list[Edit] = []
        before_here = index
        for edit in version.edits:
            try:
                again, missing = _translated(edit, before, ids)
                scene = _applied(again, before, version.index, index, max_gaussians)
                index = index.after(scene)
            except FastSplatError as error:
                lost.append(f"{_named(edit)}: {error.message}")
                continue
            made.append(again)
            lost += [f"{_named(edit)}: thing {thing_id} of the draft was not found again" for thing_id in missing]
        there, here = _made(before, version.index), _made(before_here, index)
        if len(there) == len(here):
            ids |= dict(zip(there, here, strict=True))
        before = version.index
        if made:
            versions.append(CarriedVersion(number, made, index))
    return Carried(versions, lost)


def matched_things(draft: SceneIndex, scene: SceneIndex) -> dict[int, int]:
    """For each thing of a draft that one thing of a scene is, the id of that: both fill the same space for the larger
    part, and each is the other's best. Parts and groups are not matched.

    Space is measured in the scene's Gaussians, by the pixels that each fills; a Gaussian is in the draft's thing that
    the draft's nearest Gaussian is of.
    """
    return _matched(_at(draft, scene), scene.things.owner, _weights(scene))


def _matched(there: NDArray[np.int32], here: NDArray[np.int32], weights: NDArray[np.float64]) -> dict[int, int]:
    """Which ids of `there` [G] are which of `here` [G], 0 being none."""
    if not len(here):
        return {}
    shared = np.zeros((int(there.max()) + 1, int(here.max()) + 1))
    np.add.at(shared, (there, here), weights)
    together = shared.sum(1, keepdims=True) + shared.sum(0, keepdims=True) - shared
    overlap = np.where(together > 0, shared / np.maximum(together, 1e-12), 0.0)
    overlap[0], overlap[:, 0] = 0.0, 0.0
    best, back = overlap.argmax(1), overlap.argmax(0)
    rows = [row for row in range(1, len(overlap)) if overlap[row, best[row]] >= _OVERLAP and back[best[row]] == row]
    return {row: int(best[row]) for row in rows}


def _at(source: SceneIndex, scene: SceneIndex) -> NDArray[np.int32]:
    """int32 [G]: the thing that `source` has where each Gaussian of `scene` is, 0 for none."""
    owner = source.things.owner
    if not len(owner):
        return np.zeros(len(scene.scene.gaussians), np.int32)
    nearest = cKDTree(source.scene.gaussians.means).query(scene.scene.gaussians.means)[1]
    return np.asarray(owner[nearest], np.int32)


def _weights(index: SceneIndex) -> NDArray[np.float64]:
    return seen_pixels(index.things.table.membership).astype(np.float64)


def _applied(edit: Edit, before: SceneIndex, after: SceneIndex, index: SceneIndex, max_gaussians: int | None) -> Scene:
    """The scene of `index` after an edit by which `before` became `after`."""
    if edit.prompt is not None:
        return apply_edit(index, edit, piece=_piece(before, after, index))
    if edit.source is None:
        return apply_edit(index, edit, max_gaussians=max_gaussians)
    there = replace(edit, label=None, things=_made(before, after), transform=_UNMOVED)
    return apply_edit(index, there, source=after, max_gaussians=max_gaussians)


def _made(before: SceneIndex, after: SceneIndex) -> tuple[int, ...]:
    known = {thing.id for thing in before.things.table.table}
    return tuple(thing.id for thing in after.things.table.table if thing.id not in known)


def _piece(before: SceneIndex, after: SceneIndex, index: SceneIndex) -> NDArray[np.int64]:
    """int64 [K]: the Gaussians of `index` that lie where those lie which an edit has made a new thing of."""
    return np.flatnonzero(np.isin(_at(after, index), _made(before, after)))


def _translated(edit: Edit, before: SceneIndex, ids: dict[int, int]) -> tuple[Edit, list[int]]:
    """An edit in the new scene's ids, and the things of the draft that it is about and that are not known there.

    Raises:
        NotFoundError: none of them is; or one whose size says the scene's scale.
    """
    if edit.known_sizes:
        sizes = tuple(KnownSize(**{**vars(size), "thing": _known(size.thing, ids)}) for size in edit.known_sizes)
        return replace(edit, known_sizes=sizes), []
    if edit.source is not None or not (edit.things or edit.label):
        return edit, []
    things = edited_things(before, edit)
    known = [ids[thing] for thing in things if thing in ids]
    if not known:
        raise NotFoundError("nothing that it is about was found again", field="things")
    again = replace(edit, label=None, things=tuple(known))
    return again, [thing for thing in things if thing not in ids]


def _known(thing: int, ids: dict[int, int]) -> int:
    if thing not in ids:
        raise NotFoundError(f"thing {thing} of the draft was not found again", field="known_sizes")
    return ids[thing]


def _named(edit: Edit) -> str:
    return edit.action if edit.name is None else f"{edit.action} {edit.name!r}"
