"""Groups of proposals: what the views' masks agree on is found once, and as well supported as the masks fit it."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fastsplat.service.instances.discovery.candidates import Candidate, common_weights, find_candidates, view_support
from fastsplat.service.splatting.labels.region_groups import LiftedRegions, overlaps_of
from tests.instances.known_objects import candidate, lifted

CUP, HANDLE, PLATE = range(0, 40), range(30, 40), range(40, 100)


def _found(views: Sequence[LiftedRegions]) -> list[Candidate]:
    quality = np.full(sum(len(view) for view in views), 0.9, np.float32)
    return find_candidates(overlaps_of(views), quality, min_overlap=0.5, min_views=2)


def _sets(candidates: Sequence[Candidate]) -> set[frozenset[int]]:
    return {frozenset(piece.rows.tolist()) for piece in candidates}


def test_what_every_view_proposes_alike_has_all_support() -> None:
    """Three views propose a cup, its handle and a plate; each view has them in another order."""
    views = [lifted(120, [CUP, HANDLE, PLATE]), lifted(120, [PLATE, CUP, HANDLE]), lifted(120, [HANDLE, PLATE, CUP])]
    candidates = _found(views)
    assert _sets(candidates) == {frozenset(CUP), frozenset(HANDLE), frozenset(PLATE)}
    assert all(piece.support == pytest.approx(1) and piece.consensus == 1 for piece in candidates)
    assert all(piece.proposed_in == (0, 1, 2) and (piece.shares == 1).all() for piece in candidates)
    assert {piece.weight for piece in candidates} == {40.0, 10.0, 60.0}


def test_support_is_the_mean_of_the_best_fits_of_the_views_that_see_it() -> None:
    """Three views cut a cup out exactly, one cuts out half of it, one nothing, and the last sees another place."""
    away = np.zeros(100, np.bool_)
    away[50:] = True
    exact = [lifted(100, [CUP, range(5)]) for _ in range(3)]
    views = [*exact, lifted(100, [range(20)]), lifted(100, []), lifted(100, [range(60, 80)], away)]
    whole = next(piece for piece in _found(views) if set(piece.rows.tolist()) == set(CUP))
    assert whole.support == pytest.approx((3 + 0.5 + 0) / 5)
    assert whole.proposed_in == (0, 1, 2, 3) and whole.missed_in == (4,)
    assert whole.consensus == pytest.approx(4 / 5)


def test_of_what_is_the_same_the_better_supported_remains() -> None:
    """Two views draw the edge wide, four narrow: at one overlap all are one group, at another they are two."""
    narrow, wide = range(0, 70), range(0, 100)
    views = [lifted(200, [narrow]) for _ in range(4)] + [lifted(200, [wide]) for _ in range(2)]
    (only,) = _found(views)
    assert set(only.rows.tolist()) == set(narrow) and only.support == pytest.approx((4 + 2 * 0.7) / 6)


def test_a_gaussian_belongs_if_most_views_that_propose_and_see_it_say_so() -> None:
    hidden = np.ones(60, np.bool_)
    hidden[30:40] = False
    views = [lifted(60, [CUP]), lifted(60, [CUP], hidden), lifted(60, [range(35)])]
    (only,) = _found(views)
    shares = dict(zip(only.rows.tolist(), only.shares.tolist(), strict=True))
    assert set(shares) == set(range(35))  # 35..39: one of the two views that see them
    assert shares[0] == 1 and shares[32] == 1


def test_what_one_view_alone_proposes_is_a_candidate_only_where_it_is_the_only_view() -> None:
    views = [lifted(100, [CUP, range(60, 90)]), lifted(100, [CUP]), lifted(100, [CUP])]
    assert _sets(_found(views)) == _sets(_found(views[1:2])) == {frozenset(CUP)}
    assert _found([lifted(10, []), lifted(10, [])]) == []


Span = tuple[int, int]


@settings(max_examples=60, derandomize=True)
@given(
    st.lists(st.lists(st.tuples(st.integers(0, 50), st.integers(3, 20)), max_size=5), min_size=2, max_size=5),
    st.randoms(use_true_random=False),
)
def test_supports_are_shares_and_no_two_candidates_are_the_same(views: list[list[Span]], random) -> None:
    """And neither depends on the order in which a set's fits are asked for."""
    regions = [[range(start, start + length) for start, length in spans] for spans in views]
    overlaps = overlaps_of([lifted(80, masks) for masks in regions])
    candidates = find_candidates(overlaps, np.ones(len(overlaps.owner), np.float32), min_overlap=0.5, min_views=2)
    common = common_weights(candidates, overlaps.size)
    weights = np.diag(common)
    same = common / np.maximum(weights[:, None] + weights - common, 1e-12)
    assert (same[~np.eye(len(weights), dtype=bool)] < 0.5).all()
    assert all(0 < piece.support <= 1 + 1e-6 for piece in candidates)
    assert [piece.support for piece in candidates] == sorted((piece.support for piece in candidates), reverse=True)
    shuffled = [random.sample(masks, len(masks)) for masks in regions]
    order = random.sample(range(len(views)), len(views))
    again = overlaps_of([lifted(80, shuffled[view]) for view in order])
    fits, sees = view_support(again, [piece.rows for piece in candidates])
    assert sees.all()
    for number, piece in enumerate(candidates):
        assert fits[number].mean() == pytest.approx(piece.support)
        assert {order[view] for view in np.flatnonzero(fits[number] >= 0.5)} == set(piece.proposed_in)


@settings(max_examples=40, derandomize=True)
@given(st.integers(2, 6), st.integers(0, 10**6), st.randoms(use_true_random=False))
def test_the_order_of_views_and_of_masks_does_not_matter(views: int, seed: int, random) -> None:
    """Objects whose masks slip by a little in each view."""
    rng = np.random.default_rng(seed)
    regions = []
    for _ in range(views):
        objects = [set(range(30 * obj, 30 * obj + 30)) for obj in range(4) if rng.random() < 0.8]
        regions.append([sorted(obj ^ set(rng.integers(0, 120, 3).tolist())) for obj in objects])
    quality = [np.asarray(rng.uniform(0.8, 1.0, len(masks)), np.float32) for masks in regions]
    orders = [random.sample(range(len(masks)), len(masks)) for masks in regions]
    order = random.sample(range(views), views)
    results = []
    for numbers, within in ((range(views), [range(len(masks)) for masks in regions]), (order, orders)):
        lifted_views = [lifted(120, [np.array(regions[view][mask]) for mask in within[view]]) for view in numbers]
        used = np.concatenate([quality[view][list(within[view])] for view in numbers])
        candidates = find_candidates(overlaps_of(lifted_views), used, min_overlap=0.5, min_views=2)
        results.append({frozenset(piece.rows.tolist()): round(piece.support, 6) for piece in candidates})
    assert results[0] == results[1]


def _large_capture(views: int, gaussians: int, objects: int) -> Iterator[LiftedRegions]:
    """Each view proposes a third of all objects, of half of them a part, and of a quarter a group with the next."""
    rng = np.random.default_rng(0)
    size = gaussians // objects
    for _ in range(views):
        some = rng.choice(objects - 1, objects // 3, replace=False)
        visible = np.zeros(gaussians, np.bool_)
        for obj in some:
            visible[obj * size : (obj + 2) * size] = True
        whole = [range(obj * size, (obj + 1) * size) for obj in some]
        parts = [range(obj * size, obj * size + size // 3) for obj in some[: len(some) // 2]]
        groups = [range(obj * size, (obj + 2) * size) for obj in some[: len(some) // 4]]
        yield lifted(gaussians, [*whole, *parts, *groups], visible)


def test_memory_grows_with_what_is_inside_and_not_with_pairs_of_proposals() -> None:
    """60 views × 70 proposals: a matrix of pairs alone would take 141 MB, one of proposals × Gaussians 672 MB."""
    views, gaussians = 60, 40_000
    lifted_views = list(_large_capture(views, gaussians, 120))
    count, entries = sum(len(view) for view in lifted_views), sum(len(view.rows) for view in lifted_views)
    assert count == views * 70
    tracemalloc.start()
    candidates = _found(lifted_views)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(candidates) > 119
    assert peak < 40 * entries + 10 * views * gaussians + 64 * 200 * count


def test_common_weights_are_those_of_the_shared_gaussians() -> None:
    size = np.arange(10, dtype=np.float32)
    common = common_weights([candidate(range(0, 6)), candidate(range(4, 9))], size)
    assert common.tolist() == [[15.0, 9.0], [9.0, 30.0]]
