"""Groups of proposals: what many views propose is found once, with the Gaussians that most of them agree on."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator

import numpy as np
import pytest

from fastsplat.service.instances.candidates import common_weights, find_candidates
from fastsplat.service.splatting.region_groups import LiftedRegions, overlaps_of
from tests.instances.made import candidate, lifted

BOUNDS = {"min_overlap": 0.5, "min_views": 2, "min_view_share": 0.1}


def _ones(views: list[LiftedRegions]) -> np.ndarray:
    return np.full(sum(len(view) for view in views), 0.9, np.float32)


def test_parts_wholes_and_neighbors_are_different_candidates() -> None:
    """Three views propose a cup, its handle and a plate; each view has them in another order."""
    cup, handle, plate = range(0, 40), range(30, 40), range(40, 100)
    views = [lifted(120, [cup, handle, plate]), lifted(120, [plate, cup, handle]), lifted(120, [handle, plate, cup])]
    candidates = find_candidates(overlaps_of(views), _ones(views), **BOUNDS)
    assert {frozenset(one.rows.tolist()) for one in candidates} == {frozenset(cup), frozenset(handle), frozenset(plate)}
    assert all(one.consensus == 1 and one.views == 3 and (one.shares == 1).all() for one in candidates)
    assert {one.weight for one in candidates} == {40.0, 10.0, 60.0}


def test_consensus_counts_the_views_that_could_see_it() -> None:
    """Five views see the cup and three propose it; a sixth sees the other side of the room."""
    away = np.zeros(100, np.bool_)
    away[50:] = True
    views = [lifted(100, [range(40)]) for _ in range(3)] + [lifted(100, []), lifted(100, []), lifted(100, [], away)]
    (only,) = find_candidates(overlaps_of(views), _ones(views), **BOUNDS)
    assert only.consensus == pytest.approx(3 / 5)


def test_a_gaussian_belongs_if_most_views_that_propose_and_see_it_say_so() -> None:
    hidden = np.ones(60, np.bool_)
    hidden[30:40] = False
    views = [lifted(60, [range(40)]), lifted(60, [range(40)], hidden), lifted(60, [range(35)])]
    (only,) = find_candidates(overlaps_of(views), _ones(views), **BOUNDS)
    shares = dict(zip(only.rows.tolist(), only.shares.tolist(), strict=True))
    assert set(shares) == set(range(35))  # 35..39: one of the two views that see them
    assert shares[0] == 1 and shares[32] == 1


def test_what_one_view_alone_proposes_is_no_candidate() -> None:
    views = [lifted(100, [range(40), range(60, 90)]), lifted(100, [range(40)]), lifted(100, [range(40)])]
    candidates = find_candidates(overlaps_of(views), _ones(views), **BOUNDS)
    assert [set(one.rows.tolist()) for one in candidates] == [set(range(40))]


def test_a_single_view_is_enough_where_there_is_one_only() -> None:
    views = [lifted(100, [range(40)])]
    assert len(find_candidates(overlaps_of(views), _ones(views), **BOUNDS)) == 1


def test_no_proposals_no_candidates() -> None:
    views = [lifted(10, []), lifted(10, [])]
    assert find_candidates(overlaps_of(views), np.zeros(0, np.float32), **BOUNDS) == []


def _large_capture(views: int, gaussians: int, things: int) -> Iterator[LiftedRegions]:
    """Each view proposes a third of all things, of half of them a part, and of a quarter a group with the next."""
    rng = np.random.default_rng(0)
    size = gaussians // things
    for _ in range(views):
        some = rng.choice(things - 1, things // 3, replace=False)
        visible = np.zeros(gaussians, np.bool_)
        for thing in some:
            visible[thing * size : (thing + 2) * size] = True
        whole = [range(thing * size, (thing + 1) * size) for thing in some]
        parts = [range(thing * size, thing * size + size // 3) for thing in some[: len(some) // 2]]
        groups = [range(thing * size, (thing + 2) * size) for thing in some[: len(some) // 4]]
        yield lifted(gaussians, [*whole, *parts, *groups], visible)


def test_memory_grows_with_what_is_inside_and_not_with_pairs_of_proposals() -> None:
    """60 views × 70 proposals: a matrix of pairs alone would take 141 MB, one of proposals × Gaussians 672 MB."""
    views, gaussians = 60, 40_000
    made = list(_large_capture(views, gaussians, 120))
    count, entries = sum(len(view) for view in made), sum(len(view.rows) for view in made)
    assert count == views * 70
    tracemalloc.start()
    overlaps = overlaps_of(iter(made))
    candidates = find_candidates(overlaps, np.full(count, 0.9, np.float32), **BOUNDS)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(candidates) > 119
    assert peak < 40 * entries + 10 * views * gaussians + 64 * 200 * count


def test_common_weights_are_those_of_the_shared_gaussians() -> None:
    size = np.arange(10, dtype=np.float32)
    common = common_weights([candidate(range(0, 6)), candidate(range(4, 9))], size)
    assert common.tolist() == [[15.0, 9.0], [9.0, 30.0]]
