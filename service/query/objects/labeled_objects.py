"""Labels of Gaussians, and instances of scenes without stored objects: connected Gaussians of a label."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fastsplat.service.common.logistic import logistic
from fastsplat.service.query.objects.solid_gaussians import grouped_rows, solid_rows
from fastsplat.service.scene.artefact.scene import (
    F32,
    CodeSemantics,
    Evidence,
    NameSource,
    Object,
    Objects,
    ObjectSemantics,
    Scene,
)
from fastsplat.service.scene.gaussians.connectivity import components
from fastsplat.service.scene.objects.label_evidence import UNIT, Posterior, evidence_of, posterior
from fastsplat.service.scene.objects.object_codes import classes_of_codes
from fastsplat.service.scene.objects.objects import MAX_OBJECT_ID


@dataclass(frozen=True)
class GaussianLabels:
    """Labels of G Gaussians."""

    classes: NDArray[np.int32]  # int32 [G], dictionary id of each Gaussian, 0 = undetected or never seen
    confidence: F32  # float32 [G], 0..1, the probability of that class; 0 = never seen by a labelled view


def label_gaussians(scene: Scene) -> GaussianLabels:
    """Labels Gaussians by codes (softmax of W·code + b), evidence (Dirichlet posterior) or objects."""
    semantics = scene.semantics()
    if isinstance(semantics, ObjectSemantics):
        return label_by_objects(semantics, posterior(semantics.objects.membership, len(semantics.label_ids)))
    if isinstance(semantics, Evidence):
        belief = posterior(semantics, len(scene.dictionary) + 1)
        return GaussianLabels(belief.classes, belief.confidence)
    return GaussianLabels(*classes_of_codes(semantics.codes, semantics.head))


def label_by_objects(semantics: ObjectSemantics, belief: Posterior) -> GaussianLabels:
    """Labels each Gaussian with the name of its most probable object."""
    return GaussianLabels(semantics.label_ids[belief.classes], belief.confidence)


F64 = NDArray[np.float64]

_SURE_PX = 16
"""Weight in pixels of a membership with a certain label."""
_REACH = 4.0
"""Standard deviations within which a free Gaussian joins the nearest object of its label."""
_MIN_SHARE = 0.05
_MAX_OBJECTS_A_LABEL = 1_000


def objects_of(scene: Scene) -> Objects:
    """Returns a scene's stored objects, else those of its labels."""
    return labeled_objects(scene, label_gaussians(scene)) if scene.objects is None else scene.objects


def labeled_objects(scene: Scene, labels: GaussianLabels) -> Objects:
    """Makes objects of each label's connected Gaussians, with deterministic ids.

    Ids follow the label id, then decreasing size. Gaussians below an opacity of 0.05 connect nothing (see
    `components`). Components below a twentieth of their label's largest, by opacity and confidence, are specks (leaked
    labels) and no objects. Objects are named after their labels; trained codes, if any, decide their pixels. Faint or
    speck Gaussians join the nearest object of their label within reach; other strays belong to none."""
    owner = np.zeros(len(scene.gaussians), np.int32)
    table = []
    source: NameSource = "given" if scene.facts.label_source == "given" else "detected"
    for object_id, (label_id, rows) in enumerate(islice(_pieces(scene, labels), MAX_OBJECT_ID), start=1):
        owner[rows] = object_id
        entry = scene.dictionary.entries[label_id - 1]
        table.append(Object(object_id, entry.label, source, entry.confidence))
    means = scene.gaussians.means
    free = np.flatnonzero((owner == 0) & (labels.classes > 0) & np.isfinite(means).all(axis=1))
    for label_id in np.unique(labels.classes[free]).tolist():
        member_rows = np.flatnonzero((owner > 0) & (labels.classes == label_id))
        rest = free[labels.classes[free] == label_id]
        if len(member_rows):
            distance, nearest = cKDTree(means[member_rows]).query(means[rest])
            reach = _REACH * np.exp(scene.gaussians.log_scales[member_rows].max(axis=1))
            owner[rest] = np.where(distance <= reach[nearest], owner[member_rows[nearest]], 0)
    counts = np.maximum(np.rint(_SURE_PX * UNIT * labels.confidence.astype(np.float64)), 1).astype(np.int64)
    rows = np.arange(len(owner))
    # Gaussians without a label count as none in masks, if any view has seen them.
    seen = (owner > 0) | (labels.confidence > 0)
    members = evidence_of(rows[seen], owner[seen], counts[seen], len(owner))
    coded = isinstance(scene.semantics(), CodeSemantics) and scene.gaussians.codes.shape[1] > 0
    return Objects(tuple(table), members, head=scene.head if coded else None)


def _pieces(scene: Scene, labels: GaussianLabels) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Yields each label's components without specks, by label id, largest first."""
    sizes = logistic(scene.gaussians.logit_opacities) * labels.confidence
    for label_id, members in grouped_rows(labels.classes, solid_rows(scene.gaussians)):
        for rows in _large(components(scene.gaussians, members), members, sizes):
            yield label_id, rows


def _large(component: NDArray[np.int32], members: NDArray[np.int64], sizes: F64) -> list[NDArray[np.int64]]:
    """Components that are no specks, largest first."""
    sums = np.bincount(component, weights=sizes[members])
    order = (-sums).argsort(kind="stable")
    chosen = order[sums[order] >= _MIN_SHARE * sums.max()][:_MAX_OBJECTS_A_LABEL]
    place = np.full(len(sums), -1)
    place[chosen] = np.arange(len(chosen))
    places = place[component]
    by_part = places.argsort(kind="stable")
    counts = np.bincount(places[places >= 0], minlength=len(chosen))
    sorted_members = members[by_part[(places < 0).sum() :]]
    return np.split(sorted_members, np.cumsum(counts)[:-1])
