"""Things of a scene that stores none: the connected objects of its labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from fastsplat.service.query.things.gaussian_labels import GaussianLabels
from fastsplat.service.query.things.objects import Instance
from fastsplat.service.scene.label_evidence import UNIT, evidence_of
from fastsplat.service.scene.types import CodeSemantics, NameSource, Scene, Thing, Things, semantics_of

_SURE_PX = 16
"""Membership of a Gaussian whose label is certain, pixels."""
_REACH = 4.0
"""A Gaussian of the same label this many standard deviations from a thing's nearest one belongs to the thing."""
_MAX_THINGS = 65535


def labeled_things(scene: Scene, instances: Sequence[Instance], labels: GaussianLabels) -> Things:
    """The objects of the labels as things, numbered in their order, so that the same scene always has the same ids.

    A thing bears the name of its label, and the codes that were trained on the labels, if any, decide whose a pixel is.
    Gaussians of the label that are too faint, or too few, to be an object belong to the thing of that label that they
    lie in or beside; those with none so near are strays, and belong to no thing.

    Args:
        scene: one that stores no things.
        instances: its objects, see `find_objects`.
        labels: of its G Gaussians.
    """
    owner = np.zeros(len(scene.gaussians), np.int32)
    table = []
    source: NameSource = "given" if scene.quality.get("label_source") == "given" else "detected"
    for instance in instances[:_MAX_THINGS]:
        thing = instance.object
        owner[instance.rows] = thing.thing_id
        sure = scene.dictionary.entries[thing.label_id - 1].confidence
        table.append(Thing(thing.thing_id, thing.label, source, sure))
    means = scene.gaussians.means
    free = np.flatnonzero((owner == 0) & (labels.classes > 0) & np.isfinite(means).all(axis=1))
    for label_id in np.unique(labels.classes[free]).tolist():
        own = np.flatnonzero((owner > 0) & (labels.classes == label_id))
        rest = free[labels.classes[free] == label_id]
        if len(own):
            distance, nearest = cKDTree(means[own]).query(means[rest])
            reach = _REACH * np.exp(scene.gaussians.log_scales[own].max(axis=1))
            owner[rest] = np.where(distance <= reach[nearest], owner[own[nearest]], 0)
    counts = np.maximum(np.rint(_SURE_PX * UNIT * labels.confidence.astype(np.float64)), 1).astype(np.int64)
    rows = np.arange(len(owner))
    # What has no label says so in the masks, as long as anybody has seen it.
    seen = (owner > 0) | (labels.confidence > 0)
    members = evidence_of(rows[seen], owner[seen], counts[seen], len(owner))
    coded = isinstance(semantics_of(scene), CodeSemantics) and scene.gaussians.codes.shape[1] > 0
    return Things(tuple(table), members, head=scene.head if coded else None)


def with_things(scene: Scene, things: Things) -> Scene:
    """The scene with these things, if it stores none; its labels stay what they are made from."""
    return replace(scene, things=things) if scene.things is None else scene
