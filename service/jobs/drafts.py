"""Drafts of a scene, and the repetition of their edits in the scene that replaces them.

A draft is assembled like any scene, from few views and smaller masks. Objects are found and named, but not described or
read, which took more than half of its time.

Draft and scene share one capture and world frame, so objects match by the space they fill (`_matched_objects`). From
then on, an object made by an edit corresponds to the one made by its counterpart. Prompted pieces are transferred by
position; insertions are copied from the draft.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.progress import silent
from fastsplat.service.jobs.create_scene import assemble_scene
from fastsplat.service.perception.results import Labelling
from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.edits.object_edits import edited_objects
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Scene, SceneFacts
from fastsplat.service.scene.objects.label_evidence import seen_pixels
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training.train import train
from fastsplat_contract.errors import FastSplatError, NotFoundError
from fastsplat_contract.geometry.places import KnownSize
from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3
from fastsplat_contract.jobs.job_watching import Provisional
from fastsplat_contract.messages.scenes import Edit

_SIDE = 320
_ROUNDS = 1
_FIRST = {"iterations": 200, "max_side": 240, "max_gaussians": 10_000}
"""Training of about 1 s: untrained points hide small smooth objects, which have few."""

_UNMOVED = Pose(Vector3(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
_OVERLAP = 0.25
"""Minimum IoU of matching objects; low, as drafts know an object from six masks."""


def first_draft(capture: Capture, labelling: Labelling, views: Sequence[int], settings: Settings) -> Scene:
    """Builds a briefly trained scene from the capture's points and the views labelled so far."""
    bounds = {**_FIRST, "time_budget_s": None, "evaluations": 0, "held_out_every": 0}
    splats = train(capture, labelling.learnt(), settings.training.model_copy(update=bounds), silent)
    return training_draft(splats, capture, labelling, views, settings, Provisional("points", 0.0))


def training_draft(
    splats: TrainedSplats,
    capture: Capture,
    labelling: Labelling,
    views: Sequence[int],
    settings: Settings,
    provisional: Provisional,
) -> Scene:
    """Builds a draft from the current Gaussians; other arguments and errors as for `first_draft`."""
    chosen, masks = set(views), labelling.masks
    known = tuple(mask if number in chosen else None for number, mask in enumerate(masks))
    if not any(mask is not None for mask in known):
        known = ()
    discovery = settings.discovery.model_copy(
        update={
            "max_side": min(_SIDE, settings.discovery.max_side),
            "refinement_rounds": min(_ROUNDS, settings.discovery.refinement_rounds),
            **({} if known else {"objects": "off"}),  # no mask proposals for drafts
        }
    )
    early = settings.model_copy(update={"discovery": discovery})
    labelled = replace(labelling, masks=known)
    scene = assemble_scene(splats, labelled, capture, early, SceneFacts(), {}, described=False)
    return replace(scene, facts=replace(scene.facts, draft=provisional))


@dataclass(frozen=True)
class DraftVersion:
    """A version of a draft made by people: its edits and the resulting scene."""

    edits: Sequence[Edit]
    index: SceneIndex


@dataclass(frozen=True)
class _CarriedVersion(DraftVersion):
    """Version `number` (from 0) of a draft made again: applicable edits in new ids."""

    number: int


@dataclass(frozen=True)
class _Carried:
    """Reapplied versions; `lost`: messages on edits that could not be made again."""

    versions: Sequence[_CarriedVersion]
    lost: Sequence[str]


def carry_edits(
    index: SceneIndex, draft: SceneIndex, edited: Sequence[DraftVersion], *, max_gaussians: int | None = None
) -> _Carried:
    """Reapplies a draft's edits to a new scene, omitting versions without applicable edits.

    Args:
        draft: as its job made it.
        edited: versions of the draft, each based on the one before.
    """
    ids = _matched_objects(draft, index)
    versions: list[_CarriedVersion] = []
    lost: list[str] = []
    before = draft
    for number, version in enumerate(edited):
        new_edits: list[Edit] = []
        before_here = index
        for edit in version.edits:
            try:
                again, missing = _translated(edit, before, ids)
                scene = _applied(again, before, version.index, index, max_gaussians)
                index = index.after(scene)
            except FastSplatError as error:
                lost.append(f"{_named(edit)}: {error.message}")
                continue
            new_edits.append(again)
            lost += [f"{_named(edit)}: object {object_id} of the draft was not found again" for object_id in missing]
        there, here = _new_objects(before, version.index), _new_objects(before_here, index)
        if len(there) == len(here):
            ids |= dict(zip(there, here, strict=True))
        before = version.index
        if new_edits:
            versions.append(_CarriedVersion(new_edits, index, number))
    return _Carried(versions, lost)


def _matched_objects(draft: SceneIndex, scene: SceneIndex) -> dict[int, int]:
    """Maps the draft's object ids to the scene's by mutual best overlap; parts and groups are not matched."""
    # Weighted by the pixels of the scene's Gaussians, each owned by the object of the nearest draft Gaussian.
    weights = seen_pixels(scene.objects.table.membership).astype(np.float64)
    return _matched(_at(draft, scene), scene.objects.owner, weights)


def _matched(there: NDArray[np.int32], here: NDArray[np.int32], weights: NDArray[np.float64]) -> dict[int, int]:
    """Matches ids of `there` [G] to ids of `here` [G]; 0 is none."""
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
    """Object id in `source` at each Gaussian of `scene`, int32 [G]; 0 for none."""
    owner = source.objects.owner
    if not len(owner):
        return np.zeros(len(scene.scene.gaussians), np.int32)
    nearest = cKDTree(source.scene.gaussians.means).query(scene.scene.gaussians.means)[1]
    return np.asarray(owner[nearest], np.int32)


def _applied(edit: Edit, before: SceneIndex, after: SceneIndex, index: SceneIndex, max_gaussians: int | None) -> Scene:
    """Applies to `index` the edit by which `before` became `after`."""
    if edit.prompt is not None:
        return apply_edit(index, edit, piece=_piece(before, after, index))
    if edit.source is None:
        return apply_edit(index, edit, max_gaussians=max_gaussians)
    there = replace(edit, label=None, object_ids=_new_objects(before, after), transform=_UNMOVED)
    return apply_edit(index, there, source=after, max_gaussians=max_gaussians)


def _new_objects(before: SceneIndex, after: SceneIndex) -> tuple[int, ...]:
    known = {obj.id for obj in before.objects.table.table}
    return tuple(obj.id for obj in after.objects.table.table if obj.id not in known)


def _piece(before: SceneIndex, after: SceneIndex, index: SceneIndex) -> NDArray[np.int64]:
    """Gaussians of `index` located in the object that an edit made there, int64 [K]."""
    return np.flatnonzero(np.isin(_at(after, index), _new_objects(before, after)))


def _translated(edit: Edit, before: SceneIndex, ids: dict[int, int]) -> tuple[Edit, list[int]]:
    """Translates an edit to new ids, with unmatched objects; `NotFoundError` if none matches."""
    if edit.known_sizes:
        sizes = tuple(
            KnownSize(**{**vars(size), "object_id": _known(size.object_id, ids)}) for size in edit.known_sizes
        )
        return replace(edit, known_sizes=sizes), []
    if edit.source is not None or not (edit.object_ids or edit.label):
        return edit, []
    objects = edited_objects(before, edit)
    known = [ids[obj] for obj in objects if obj in ids]
    if not known:
        raise NotFoundError("nothing that it is about was found again", field="object_ids")
    again = replace(edit, label=None, object_ids=tuple(known))
    return again, [obj for obj in objects if obj not in ids]


def _known(object_id: int, ids: dict[int, int]) -> int:
    if object_id not in ids:
        raise NotFoundError(f"object {object_id} of the draft was not found again", field="known_sizes")
    return ids[object_id]


def _named(edit: Edit) -> str:
    return edit.action if edit.name is None else f"{edit.action} {edit.name!r}"
