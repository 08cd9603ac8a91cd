"""How good the objects of a scene are, by the truth of a drawn room: on the test views, by clicks, in space, by
name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from benchmarks.calibration.fit_names import is_right
from benchmarks.evaluation.datasets.dataset import Dataset
from benchmarks.evaluation.metrics import mean
from benchmarks.evaluation.object_discovery import (
    MIN_PIXELS,
    ObjectCounts,
    count_objects,
    precision_at,
    recall_at,
    simulate_clicks,
    true_objects,
    widest,
)
from benchmarks.evaluation.published.mask_pairs import mask_iou
from benchmarks.rooms.shapes import F64
from benchmarks.rooms.truth import Truth
from fastsplat.service.perception.class_names import COCO_80
from fastsplat.service.query.drawing.scene_renderer import Renderer
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.scene.artefact.scene import Gaussians, Scene
from fastsplat.service.scene.objects.objects import object_rows
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.labels.blending import object_map
from fastsplat.service.splatting.raster.rendering import rasterize

MARGIN = 0.01
"""Meters: what lies farther outside the box of an object is fog."""
SECOND_CLICKS = 0.3
"""Share of the objects that get a second click: those that the first one selects worst."""

_IS = 0.5
"""Intersection over union from which a discovered object is a true one."""
_REACH, _THINNEST = 2.0, 0.003
"""A surface is covered within so many standard deviations of a Gaussian, which are at least so wide, meters."""
_NEIGHBORS = 12
_AT = 0.03
"""Meters from a surface within which a Gaussian is of it; farther from all it hangs in the air."""

Maps = Mapping[str, NDArray[np.int32]]


@dataclass(frozen=True)
class Measured:
    """A scene and the truth of its room.

    Attributes:
        scene: with objects.
        dataset: the test views.
        truth: of the room in space.
        objects, parts: the object and the part of each pixel of each test view, by name.
        counts: of all test views.
    """

    scene: Scene
    dataset: Dataset
    truth: Truth
    objects: Maps
    parts: Maps
    counts: ObjectCounts

    def matches(self) -> dict[int, int]:
        """The discovered object, by its place in the table, of each true object that is one."""
        iou, present = self.counts.iou(), self.counts.present
        best = {row: int(iou[row].argmax()) for row in np.flatnonzero(present).tolist() if iou.shape[1]}
        return {row + 1: place for row, place in best.items() if iou[row, place] >= _IS}


def measured(scene: Scene, dataset: Dataset, truth: Truth) -> Measured:
    """The maps and counts that figures are made of."""
    posed = {view.name: view.posed for view in dataset.test if view.posed is not None}
    objects = {name: object_map(scene, camera) for name, camera in posed.items()}
    scene_parts = None if scene.objects is None else scene.objects.parts
    renderer = Renderer(scene, QuerySettings())
    parts = {
        name: np.zeros(ids.shape, np.int32)
        if scene_parts is None
        else renderer.id_map(posed[name], scene_parts).astype(np.int32)
        for name, ids in objects.items()
    }
    return Measured(scene, dataset, truth, objects, parts, count_objects(scene, dataset, objects))


def figures_of(scene: Measured) -> dict[str, Any]:
    """All figures of one room, by name."""
    counts = scene.counts
    best = counts.iou().max(axis=1, initial=0)
    kinds = np.array(scene.truth.surfaces[: len(best)])
    surfaces = counts.present & (kinds != "")
    figures: dict[str, Any] = {
        "objects_true": int(counts.present.sum()),
        "objects_judged": int(counts.judged.sum()),
        "recall_50": recall_at(counts, 0.5),
        "recall_75": recall_at(counts, 0.75),
        "precision": precision_at(counts, 0.5),
        "mean_iou": float(best[counts.present].mean()),
        "clicks_miou": simulate_clicks(scene.dataset, scene.objects),
        **_clicked(scene),
        "surfaces_iou": mean(best[surfaces].tolist()),
        **{f"{kind}_iou": mean(best[counts.present & (kinds == kind)].tolist()) for kind in sorted(set(kinds) - {""})},
        **_parted(scene),
        **_in_space(scene),
        **_named(scene),
    }
    return {name: round(value, 4) if isinstance(value, float) else value for name, value in figures.items()}


def worst_of(scene: Measured, count: int = 8) -> list[str]:
    """The true objects with the lowest intersection over union, with it."""
    best = scene.counts.iou().max(axis=1, initial=0)
    rows = [row for row in np.argsort(best, kind="stable").tolist() if scene.counts.present[row]]
    return [f"{row + 1} {scene.truth.labels[row]} {best[row]:.2f}" for row in rows[:count]]


def _clicked(scene: Measured) -> dict[str, float]:
    """What a click selects, and what a second one on the worst adds: an object where something is missing, or the part
    under the first click in place of its object, whichever a person would keep."""
    views = [view for view in scene.dataset.test if view.name in scene.objects]
    truth = np.stack([true_objects(view) for view in views])
    objects = np.stack([scene.objects[view.name] for view in views])
    parts = np.stack([scene.parts[view.name] for view in views])
    once, twice = [], []
    for number in (np.flatnonzero(scene.counts.present) + 1).tolist():
        meant = truth == number
        spot = _spot(meant)
        selected = (objects == objects[spot]) & (objects[spot] > 0)
        once.append(mask_iou(selected, meant))
        options = [once[-1]]
        missing = meant & ~selected
        if missing.any() and (more := objects[_spot(missing)]) > 0:
            options.append(mask_iou(selected | (objects == more), meant))
        if parts[spot] > 0:
            options.append(mask_iou(parts == parts[spot], meant))
        twice.append(max(options))
    first, second = np.array(once), np.array(twice)
    worst = np.argsort(first, kind="stable")[: int(SECOND_CLICKS * len(first))]
    after = first.copy()
    after[worst] = second[worst]
    return {"selected_miou": float(first.mean()), "clicks_1.3_miou": float(after.mean())}


def _parted(scene: Measured) -> dict[str, float | int]:
    """The share of the true parts that are a discovered part, or object, by an intersection over union of 0.5."""
    names = scene.truth.names
    truth, objects, parts = (
        scene.truth.parts,
        *(np.stack([of[name] for name in names]) for of in (scene.objects, scene.parts)),
    )
    best = []
    for number in range(1, len(scene.truth.part_names) + 1):
        meant = truth == number
        if meant.sum() < MIN_PIXELS:
            continue
        pairs = [(ids, ids[meant]) for ids in (objects, parts)]
        likely = [(ids, int(np.bincount(inside).argmax())) for ids, inside in pairs]
        best.append(max(mask_iou(ids == number_there, meant) if number_there else 0.0 for ids, number_there in likely))
    return {"parts_true": len(best), "parts_recall_50": mean([float(iou >= _IS) for iou in best])}


def _spot(mask: NDArray[np.bool_]) -> tuple[int, int, int]:
    """Where a person clicks: in the view that shows most of it, where it is widest."""
    view = int(mask.sum(axis=(1, 2)).argmax())
    return (view, *widest(mask[view]))


def _in_space(scene: Measured) -> dict[str, float]:
    """Means over true objects that were discovered and are no surfaces: the share of their Gaussians, by opacity,
    outside their box, and of these that at another object; the share covered of what training views show of them; and
    the intersection over union of their silhouettes, drawn alone."""
    gaussians, truth = scene.scene.gaussians, scene.truth
    assert scene.scene.objects is not None
    rows, table = object_rows(scene.scene.objects), scene.scene.objects.table
    surfaces = cKDTree(truth.points.astype(np.float64))
    outside, elsewhere, covered, alone = [], [], [], []
    for number, place in scene.matches().items():
        members = np.flatnonzero(rows == table[place].id)
        if truth.surfaces[number - 1] or not len(members):
            continue
        opacity = 1 / (1 + np.exp(-gaussians.logit_opacities[members].astype(np.float64)))
        means = gaussians.means[members].astype(np.float64)
        out = truth.outside(number, means, MARGIN)
        distance, nearest = surfaces.query(means)
        at_another = out & (distance <= _AT) & (truth.owners[nearest] != number)
        outside.append(float(opacity[out].sum() / opacity.sum()))
        elsewhere.append(float(opacity[at_another].sum() / opacity.sum()))
        single = _rows_of(gaussians, members)
        points = truth.points[truth.owners == number].astype(np.float64)
        if len(points):
            covered.append(float(_covers(single, points).mean()))
        alone.append(_silhouette_iou(single, scene, number))
    return {
        "outside_box": mean(outside),
        "outside_at_others": mean(elsewhere),
        "covered": mean(covered),
        "alone_miou": mean(alone),
    }


def _rows_of(gaussians: Gaussians, rows: NDArray[np.integer]) -> Gaussians:
    return replace(gaussians, **{field.name: getattr(gaussians, field.name)[rows] for field in fields(gaussians)})


def _covers(gaussians: Gaussians, points: F64) -> NDArray[np.bool_]:
    """bool [K]: whether a Gaussian near each point [K, 3] reaches it."""
    means = gaussians.means.astype(np.float64)
    near = cKDTree(means).query(points, k=min(_NEIGHBORS, len(means)))[1].reshape(len(points), -1)
    turns = Rotation.from_quat(gaussians.quats[:, [1, 2, 3, 0]].astype(np.float64)).as_matrix()
    scales = np.maximum(np.exp(gaussians.log_scales.astype(np.float64)), _THINNEST)
    along = np.einsum("knji,knj->kni", turns[near], points[:, None] - means[near])
    return np.asarray((np.linalg.norm(along / scales[near], axis=2) <= _REACH).any(axis=1))


def _silhouette_iou(gaussians: Gaussians, scene: Measured, number: int) -> float:
    splats = splats_of(gaussians)
    common = union = 0
    posed_of = {view.name: view.posed for view in scene.dataset.test}
    for place, name in enumerate(scene.truth.names):
        posed = posed_of[name]
        assert posed is not None
        viewmat = torch.from_numpy(posed.camera_from_world().astype(np.float32))
        with torch.no_grad():
            drawn = rasterize(splats, viewmat, posed.camera).alpha.numpy() >= 0.5
        meant = scene.truth.silhouettes[place, number - 1]
        common, union = common + int((drawn & meant).sum()), union + int((drawn | meant).sum())
    return common / max(1, union)


def _named(scene: Measured) -> dict[str, float | int]:
    """Of the names that discovered objects were given, and of those of them that are stated as no guess, how many are
    right; of the true objects whose name the detector knows, how many are so named."""
    assert scene.scene.objects is not None
    table, labels = scene.scene.objects.table, scene.truth.labels
    matches = scene.matches()
    truly = {place: labels[number - 1] for number, place in matches.items()}
    given = [place for place in np.flatnonzero(scene.counts.judged).tolist() if table[place].name]
    right = [place for place in given if place in truly and is_right(truly[place], table[place].name)]
    present = (np.flatnonzero(scene.counts.present) + 1).tolist()
    knowable = [number for number in present if labels[number - 1] in COCO_80]
    known = sum(number in matches and table[matches[number]].name == labels[number - 1] for number in knowable)
    return {
        "names_given": len(given),
        "names_given_right": len(right),
        "names_stated": sum(not table[place].guessed for place in given),
        "names_stated_right": sum(not table[place].guessed for place in right),
        "names_knowable": len(knowable),
        "names_known": known,
    }
