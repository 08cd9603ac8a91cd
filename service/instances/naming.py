"""Names for things: what a detector, or label maps, call their regions, counted over all views."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.instances.name_calibration import name_probability
from fastsplat.service.perception.types import Regions
from fastsplat.service.scene.suggestions import Suggestion
from fastsplat.service.scene.things import thing_rows
from fastsplat.service.scene.types import NameSource, Thing, Things
from fastsplat.service.splatting.region_groups import LiftedRegions

NAMED_FROM = 0.6
"""A detected name is given from this probability; below, it is a suggestion (see `Thing.guessed`). Of names given from
here on 176 of 217 were right in other rooms."""
_GIVEN_FROM, _GIVEN_RIVALS = 0.28, 0.5
"""A name of label maps is given from this share of the views, if no other has more than this part of it."""

F64 = NDArray[np.float64]

SEEN_PX = 0.05
"""Weight from which a view sees a Gaussian."""
MOST_SEEN = 0.5
"""Share of a thing that a view must see for its silence to count."""
_SUGGESTIONS = 3
LEAST_SUGGESTED = 0.05
"""Less probable names are not worth a suggestion."""


@dataclass(frozen=True)
class NameVotes:
    """What the views call T things.

    Attributes:
        scores: float64 [T, N + 1]: sum over views of the score that a label got for a thing, 0..1 a view.
        able: float64 [T]: number of views that see most of the thing, and so could have named it.
        unmatched: number of regions with votes that are no thing's.
        voted: float64 [T]: number of views in which a region with votes is the thing, seen in part or whole.
    """

    scores: F64
    able: F64
    unmatched: int = 0
    voted: F64 | None = None

    @property
    def mean_scores(self) -> F64:
        """float64 [T, N + 1], 0..1: the mean score of each label over the views that could have named the thing, the
        views that are silent counting as 0; [:, 0] is 0."""
        mean = np.minimum(self.scores / np.maximum(self.able, 1)[:, None], 1.0)
        mean[:, 0] = 0
        return mean


def count_votes(
    things: Things, lifted: Iterable[LiftedRegions], regions: Sequence[Regions], labels: int, *, min_overlap: float
) -> NameVotes:
    """The votes of the regions of all views.

    In every view a region votes for the one thing that it overlaps most, by the intersection over union of the
    Gaussians that the view sees, if by at least `min_overlap`. For each label the best score of a view counts.

    Args:
        lifted: the regions of each view, in order; consumed one at a time.
        regions: the same regions with their votes.
        labels: N.
        min_overlap: 0..1.
    """
    place = np.zeros(max((thing.id for thing in things.table), default=0) + 1, np.int64)
    place[[thing.id for thing in things.table]] = np.arange(1, len(things.table) + 1)
    owner = place[thing_rows(things)]
    count = len(things.table)
    whole = np.bincount(owner, minlength=count + 1)[1:]
    scores, able, voted, unmatched = np.zeros((count, labels + 1)), np.zeros(count), np.zeros(count), 0
    for view, own in zip(lifted, regions, strict=True):
        sees = view.pixels > SEEN_PX
        visible = np.bincount(owner[sees], minlength=count + 1)[1:]
        able += visible > MOST_SEEN * np.maximum(whole, 1)
        best = np.zeros((count, labels + 1))
        for region in range(len(view)):
            rows = view.rows[view.starts[region] : view.starts[region + 1]]
            common = np.bincount(owner[rows], minlength=count + 1)[1:]
            overlap = common / np.maximum(visible + len(rows) - common, 1)
            thing = int(overlap.argmax()) if count else 0
            if count and overlap[thing] >= min_overlap:
                for label, score in own.votes[region]:
                    best[thing, label] = max(best[thing, label], score)
            elif own.votes[region]:
                unmatched += 1
        scores += best
        voted += best.any(axis=1)
    return NameVotes(scores, np.maximum(able, (scores > 0).any(axis=1)), unmatched, voted)


def name_things(things: Things, votes: NameVotes, names: Sequence[str], source: NameSource) -> Things:
    """The same things, named from `NAMED_FROM` of `name_probability` (of exact label maps: the share of views), else
    with suggestions; a name by a person stays.
    """
    probability = votes.mean_scores if source == "given" else name_probability(votes.mean_scores, names)
    table = tuple(
        thing if thing.source == "person" else _named(thing, row, names, source)
        for thing, row in zip(things.table, probability, strict=True)
    )
    return replace(things, table=table)


def _named(thing: Thing, row: F64, names: Sequence[str], source: NameSource) -> Thing:
    order = np.argsort(-row, kind="stable")
    order = order[row[order] >= LEAST_SUGGESTED][:_SUGGESTIONS]
    suggestions = tuple(Suggestion(names[label - 1], float(row[label])) for label in order)
    if not suggestions:
        return replace(thing, name="", source=None, probability=0.0, suggestions=())
    best, sure, rivals = suggestions[0].name, suggestions[0].probability, suggestions[1:]
    clear = sure >= NAMED_FROM
    if source == "given":
        clear = sure >= _GIVEN_FROM and all(other.probability <= _GIVEN_RIVALS * sure for other in rivals)
    if not clear:
        return replace(thing, name="", source=None, probability=0.0, suggestions=suggestions)
    return replace(thing, name=best, source=source, probability=sure, suggestions=rivals)
