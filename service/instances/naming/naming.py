"""Names of objects from detections or label maps, counted over all views."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.instances.naming.name_models import NameModel
from fastsplat.service.perception.results import Regions
from fastsplat.service.scene.artefact.scene import NameSource, Object, Objects
from fastsplat.service.scene.artefact.suggestions import Suggestion
from fastsplat.service.scene.objects.objects import object_rows
from fastsplat.service.splatting.labels.region_groups import LiftedRegions

NAMED_FROM = 0.6
"""Least probability of a name; below, it is a suggestion (see `Object.guessed`).

Of names given from here on, 176 of 217 were right in other rooms.
"""
_GIVEN_FROM, _GIVEN_RIVALS = 0.28, 0.5  # least share of views for a label map's name, and largest ratio of rivals

F64 = NDArray[np.float64]

SEEN_PX = 0.05
"""Weight from which a view sees a Gaussian."""
MOST_SEEN = 0.5
"""Share of an object that a view must see for its silence to count."""
_SUGGESTIONS = 3
LEAST_SUGGESTED = 0.05
"""Least probability of a suggestion."""

_UNMEASURED_AT_MOST = 0.5  # probability by a detector whose scores were not measured, which so suggests only


@dataclass(frozen=True)
class NameVotes:
    """Votes of the views for names of T objects."""

    scores: F64  # [T, N + 1], sum over views of the label's score, 0..1 a view
    able: F64  # [T], views that see most of the object, and so could have named it
    unmatched: int = 0  # regions with votes that match no object
    voted: F64 | None = None  # [T], views with a voting region that matches the object

    @property
    def mean_scores(self) -> F64:
        """Mean scores [T, N + 1] of `able` views (silent: 0); [:, 0] is 0."""
        mean = np.minimum(self.scores / np.maximum(self.able, 1)[:, None], 1.0)
        mean[:, 0] = 0
        return mean


def count_votes(
    objects: Objects, lifted: Iterable[LiftedRegions], regions: Sequence[Regions], labels: int, *, min_overlap: float
) -> NameVotes:
    """Counts the votes of the regions of all views.

    A region votes for the object with the highest intersection over union of the Gaussians that the view sees, if at
    least `min_overlap`, 0..1. Each view counts with its best score per label.

    Args:
        lifted: the regions of each view, in order; consumed one at a time.
        regions: the same regions with their votes.
        labels: N.
    """
    place = np.zeros(max((obj.id for obj in objects.table), default=0) + 1, np.int64)
    place[[obj.id for obj in objects.table]] = np.arange(1, len(objects.table) + 1)
    owner = place[object_rows(objects)]
    count = len(objects.table)
    whole = np.bincount(owner, minlength=count + 1)[1:]
    scores, able, voted, unmatched = np.zeros((count, labels + 1)), np.zeros(count), np.zeros(count), 0
    for view, view_regions in zip(lifted, regions, strict=True):
        sees = view.pixels > SEEN_PX
        visible = np.bincount(owner[sees], minlength=count + 1)[1:]
        able += visible > MOST_SEEN * np.maximum(whole, 1)
        best = np.zeros((count, labels + 1))
        for region in range(len(view)):
            rows = view.rows[view.starts[region] : view.starts[region + 1]]
            common = np.bincount(owner[rows], minlength=count + 1)[1:]
            overlap = common / np.maximum(visible + len(rows) - common, 1)
            obj = int(overlap.argmax()) if count else 0
            if count and overlap[obj] >= min_overlap:
                for label, score in view_regions.votes[region]:
                    best[obj, label] = max(best[obj, label], score)
            elif view_regions.votes[region]:
                unmatched += 1
        scores += best
        voted += best.any(axis=1)
    return NameVotes(scores, np.maximum(able, (scores > 0).any(axis=1)), unmatched, voted)


def name_objects(
    objects: Objects, votes: NameVotes, names: Sequence[str], source: NameSource, model: NameModel | None
) -> Objects:
    """Names objects from `NAMED_FROM`, otherwise suggests; names given by persons stay.

    The probability is `name_probability`; for exact label maps it is the share of views.
    """
    scores = votes.mean_scores
    probability = scores if source == "given" else name_probability(scores, names, model)
    table = tuple(
        obj if obj.source == "person" else _named(obj, row, names, source)
        for obj, row in zip(objects.table, probability, strict=True)
    )
    return replace(objects, table=table)


def _named(obj: Object, row: F64, names: Sequence[str], source: NameSource) -> Object:
    order = np.argsort(-row, kind="stable")
    order = order[row[order] >= LEAST_SUGGESTED][:_SUGGESTIONS]
    suggestions = tuple(Suggestion(names[label - 1], float(row[label])) for label in order)
    if not suggestions:
        return replace(obj, name="", source=None, probability=0.0, suggestions=())
    best, sure, rivals = suggestions[0].name, suggestions[0].probability, suggestions[1:]
    clear = sure >= NAMED_FROM
    if source == "given":
        clear = sure >= _GIVEN_FROM and all(rival.probability <= _GIVEN_RIVALS * sure for rival in rivals)
    if not clear:
        return replace(obj, name="", source=None, probability=0.0, suggestions=suggestions)
    return replace(obj, name=best, source=source, probability=sure, suggestions=rivals)


def name_evidence(scores: F64) -> F64:
    """Evidence of labels, [T, N + 1], 0..1, from `NameVotes.mean_scores`.

    A mean score times its share of the object's scores: names that are rare among views, or contested, get less.
    """
    total = scores.sum(axis=1, keepdims=True)
    return np.asarray(scores * np.divide(scores, total, out=np.zeros_like(scores), where=total > 0))


def name_probability(scores: F64, names: Sequence[str], model: NameModel | None) -> F64:
    """Calibrated probability of labels, float64 [T, N + 1], 0..1; 0 without votes.

    Of a detector that was not measured, or is no better than chance, it is the evidence, at most one half.

    Args:
        scores: see `name_evidence`; [:, 0] is 0.
        names: of labels 1..N.
        model: of the detector.
    """
    evidence = name_evidence(scores)
    if model is None or not model.measured:
        return np.minimum(evidence, _UNMEASURED_AT_MOST)
    evidence[:, 1:] = model.probability(evidence[:, 1:], names)
    return np.where(scores > 0, evidence, 0.0)
