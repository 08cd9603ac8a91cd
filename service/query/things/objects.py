"""Things, not only labels: connected Gaussians of one label, each with a place, a box and the views that see it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.logistic import logistic
from fastsplat.service.query.things.gaussian_labels import GaussianLabels
from fastsplat.service.query.things.visibility import best_views
from fastsplat.service.scene.boxes import oriented_box
from fastsplat.service.scene.connectivity import components
from fastsplat.service.scene.things import part_rows, thing_rows
from fastsplat.service.scene.types import F32, Gaussians, Scene
from fastsplat_contract.poses import vector3
from fastsplat_contract.scenes import SceneObject

F64 = NDArray[np.float64]

MIN_OPACITY = 0.05
"""A Gaussian less opaque than this is nothing one sees."""
_MIN_SHARE = 0.05
_WIDEST = 4.0
_LEAST = 1e-6
_MAX_OBJECTS_A_LABEL = 1_000


class Instance(NamedTuple):
    """One thing, and its Gaussians: int32 [K], ascending row numbers.

    Its id is "label id-number", numbered from the largest, and the same in every index of the same scene. The z axis of
    its box is the scene's vertical where it tells one (`Scene.up`), the x axis the longer of the other two. It has at
    most five best views.
    """

    object: SceneObject
    rows: NDArray[np.int32]


def find_objects(scene: Scene, field: GaussianLabels) -> tuple[Instance, ...]:
    """All objects of a scene, by label id, then from the largest.

    Gaussians less opaque than 0.05 belong to no object. Of one label those that touch (see `components`) are one
    object. A component with less than a twentieth of what its label's largest has is a speck, and no object: labels
    that leak onto what stands behind look like that. Sizes count Gaussians, by opacity and confidence; centroids and
    boxes weigh them by area as well, up to four times the usual one, so that what leaked far away, where Gaussians are
    wide, does not outweigh the thing.
    """
    areas = masses(scene.gaussians.log_scales, scene.gaussians.logit_opacities)
    sizes = logistic(scene.gaussians.logit_opacities) * field.confidence
    parts: list[_Part] = []
    for label_id, members in grouped_rows(field.classes, solid_rows(scene.gaussians)):
        areas[members] = np.minimum(areas[members], _WIDEST * np.median(areas[members]))
        objects = _large(components(scene.gaussians, members), members, sizes)
        parts += [_Part(label_id, number, len(parts) + number, rows) for number, rows in enumerate(objects, start=1)]
    return _instances(scene, field, parts, areas)


def objects_of_things(scene: Scene, field: GaussianLabels, known: dict[int, Instance | None]) -> tuple[Instance, ...]:
    """The named things, and named parts, of a scene that stores things, by the label id of their names, then from the
    largest; their scores take in the probability of the name. Sizes, centroids and boxes are as in `find_objects`.

    Args:
        scene: whose labels are the names of its things.
        field: labels of its Gaussians.
        known: things of the same Gaussians that were described before, whatever their names were, by id, None for what
            cannot be seen; what is missing is added.
    """
    assert scene.things is not None
    label_ids = {thing.id: scene.dictionary.id_of(thing.name) for thing in scene.things.everything if thing.name}
    missing = {thing_id for thing_id, label_id in label_ids.items() if label_id and thing_id not in known}
    if missing:
        _describe(scene, field, missing, known)
    labeled: dict[int, list[tuple[float, Instance]]] = {}
    opacities = logistic(scene.gaussians.logit_opacities)
    for thing_id, label_id in label_ids.items():
        instance = known.get(thing_id)
        if label_id and instance is not None:
            labeled.setdefault(label_id, []).append((-float(opacities[instance.rows].sum()), instance))
    probability = {thing.id: thing.probability for thing in scene.things.everything}
    instances = []
    for label_id, own in sorted(labeled.items()):
        own.sort(key=itemgetter(0))
        for number, (_, instance) in enumerate(own, start=1):
            named = replace(
                instance.object,
                id=f"{label_id}-{number}",
                label_id=label_id,
                label=scene.dictionary.label_of(label_id),
                score=instance.object.score * probability[instance.object.thing_id],
            )
            instances.append(instance._replace(object=named))
    return tuple(instances)


def _describe(scene: Scene, field: GaussianLabels, thing_ids: set[int], known: dict[int, Instance | None]) -> None:
    """Adds these things to `known`, under a label and a number that mean nothing."""
    assert scene.things is not None
    gaussians = scene.gaussians
    for owner in (thing_rows(scene.things), part_rows(scene.things)):
        areas = masses(gaussians.log_scales, gaussians.logit_opacities)
        groups: list[_Part] = []
        for thing_id, rows in grouped_rows(owner, solid_rows(gaussians)):
            if thing_id in thing_ids:
                areas[rows] = np.minimum(areas[rows], _WIDEST * np.median(areas[rows]))
                groups.append(_Part(1, 1, thing_id, rows))
        visible = {instance.object.thing_id: instance for instance in _instances(scene, field, groups, areas)}
        known.update({thing_id: visible.get(thing_id, known.get(thing_id)) for thing_id in thing_ids})


def solid_rows(gaussians: Gaussians) -> NDArray[np.int64]:
    """int64 [K], ascending: the Gaussians that one sees: opaque enough, and of finite place and size."""
    areas = masses(gaussians.log_scales, gaussians.logit_opacities)
    solid = gaussians.logit_opacities >= np.log(MIN_OPACITY / (1 - MIN_OPACITY))
    return np.flatnonzero(solid & np.isfinite(gaussians.means).all(axis=1) & np.isfinite(areas))


def grouped_rows(groups: NDArray[np.int32], rows: NDArray[np.int64]) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """The numbers above 0 that `groups` [G] has at `rows` [K], ascending, each with its rows, ascending."""
    inside = rows[groups[rows] > 0]
    ordered = inside[groups[inside].argsort(kind="stable")]
    numbers, starts = np.unique(groups[ordered], return_index=True)
    if len(numbers):
        yield from zip(numbers.tolist(), np.split(ordered, starts[1:]), strict=True)


class _Part(NamedTuple):
    label_id: int
    number: int
    thing_id: int
    rows: NDArray[np.int64]


def _instances(scene: Scene, field: GaussianLabels, parts: Sequence[_Part], areas: F64) -> tuple[Instance, ...]:
    if not parts:
        return ()
    up = scene.up()
    views = best_views(scene, [part.rows for part in parts], areas)
    weights = areas * np.maximum(field.confidence, _LEAST)
    return tuple(_described(scene, field, weights, up, part, seen) for part, seen in zip(parts, views, strict=True))


def masses(log_scales: F32, logit_opacities: F32) -> F64:
    """float64 [G]: opacity times the product of the two larger standard deviations: how much surface a Gaussian is."""
    logs = log_scales.astype(np.float64)
    area = np.exp(logs.sum(axis=1) - logs.min(axis=1))
    return np.asarray(np.maximum(area * logistic(logit_opacities), np.finfo(np.float64).tiny))


def _large(component: NDArray[np.int32], members: NDArray[np.int64], sizes: F64) -> list[NDArray[np.int64]]:
    """The components that are no specks, largest first."""
    sums = np.bincount(component, weights=sizes[members])
    order = (-sums).argsort(kind="stable")
    chosen = order[sums[order] >= _MIN_SHARE * sums.max()][:_MAX_OBJECTS_A_LABEL]
    place = np.full(len(sums), -1)
    place[chosen] = np.arange(len(chosen))
    kept = place[component]
    by_part = kept.argsort(kind="stable")
    counts = np.bincount(kept[kept >= 0], minlength=len(chosen))
    sorted_members = members[by_part[(kept < 0).sum() :]]
    return np.split(sorted_members, np.cumsum(counts)[:-1])


def _described(
    scene: Scene,
    field: GaussianLabels,
    weights: F64,
    up: F64 | None,
    part: _Part,
    views: tuple[str, ...],
) -> Instance:
    label_id, number, thing_id, rows = part
    means, mass = scene.gaussians.means[rows].astype(np.float64), weights[rows]
    thing = SceneObject(
        id=f"{label_id}-{number}",
        label_id=label_id,
        label=scene.dictionary.label_of(label_id),
        score=float(np.average(field.confidence[rows], weights=mass)),
        centroid=vector3(np.average(means, axis=0, weights=mass)),
        box=oriented_box(means, mass, up),
        gaussian_count=len(rows),
        meters=scene.scale == "METRIC",
        best_views=views,
        thing_id=thing_id,
    )
    return Instance(thing, rows.astype(np.int32))
