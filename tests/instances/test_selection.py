"""Parts are no things, groups are no things, surfaces are whole, and every Gaussian has one owner at most."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fastsplat.service.instances.hierarchy import find_hierarchy
from fastsplat.service.instances.ownership import (
    NOBODY,
    assign_owners,
    with_neighbors,
    with_weak_votes,
    without_strays,
)
from fastsplat.service.instances.selection import select_things
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.instances.surfaces import Plane, fit_plane, grow_surfaces, surface_kinds
from tests.instances.made import candidate, gaussians_at, grid

SETTINGS = DiscoverySettings(min_weight_px=5)
UP = np.array([0.0, 0.0, 1.0])


def test_parts_things_and_groups() -> None:
    size = np.ones(400, np.float32)
    cup, handle = candidate(range(0, 100), consensus=0.9), candidate(range(80, 100), consensus=0.65)
    plate, both = candidate(range(100, 200), consensus=0.95), candidate(range(0, 200), consensus=0.7)
    rare = candidate(range(300, 400), consensus=0.4)
    hierarchy = find_hierarchy([cup, handle, plate, both, rare], size, SETTINGS)
    assert set(hierarchy.things) == {0, 2}
    assert hierarchy.part_of == {1: 0}
    assert hierarchy.groups == {3: (0, 2)} or hierarchy.groups == {3: (2, 0)}


def test_what_is_sure_and_lies_in_another_is_a_thing_of_its_own() -> None:
    size = np.ones(100, np.float32)
    bowl = candidate(range(0, 100))
    assert set(find_hierarchy([bowl, candidate(range(10), consensus=0.95)], size, SETTINGS).things) == {0, 1}
    assert set(find_hierarchy([bowl, candidate(range(10), consensus=0.7)], size, SETTINGS).things) == {0}


def test_a_large_part_that_views_are_surer_of_is_a_thing_of_its_own() -> None:
    """Doll and bed as one, by fewer views than the bed alone."""
    size = np.ones(100, np.float32)
    both, bed = candidate(range(0, 100), consensus=0.62), candidate(range(60, 100), consensus=0.74)
    assert find_hierarchy([both, bed], size, SETTINGS).things == (0, 1)
    small = candidate(range(95, 100), consensus=0.74)
    assert find_hierarchy([both, small], size, SETTINGS).things == (0,)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 90), st.integers(1, 40)), max_size=8))
def test_the_smallest_thing_owns(spans: list[tuple[int, int]]) -> None:
    things = [
        candidate(range(start, min(100, start + length)), share=0.5 + 0.01 * n)
        for n, (start, length) in enumerate(spans)
    ]
    owners, shares = assign_owners(things, 100)
    for row in range(100):
        having = [n for n, thing in enumerate(things) if row in thing.rows]
        if not having:
            assert owners[row] == NOBODY and shares[row] == 0
        else:
            assert things[owners[row]].weight == min(things[n].weight for n in having)
            assert shares[row] == pytest.approx(things[owners[row]].shares[0])


def test_strays_are_left_out_and_whole_things_stay() -> None:
    points = np.concatenate([grid(1, 1, 0.05), grid(0.1, 0.1, 0.05, height=5.0)])
    owners = np.zeros(len(points), np.int32)
    left = without_strays(owners, gaussians_at(points), np.ones(len(points), np.float32), 0.1)
    assert (left[:400] == 0).all() and (left[400:] == NOBODY).all()


def test_weak_votes_take_what_nobody_owns_and_nothing_else() -> None:
    owners = np.array([0, NOBODY, NOBODY, NOBODY, 1], np.int32)
    things = [
        replace(candidate([0]), weak_rows=np.arange(5), weak_shares=np.array([1, 0.3, 0.3, 0.1, 0.4], np.float32)),
        replace(candidate([4]), weak_rows=np.array([0, 2, 3]), weak_shares=np.array([0.4, 0.4, 0.15], np.float32)),
    ]
    result, shares = with_weak_votes(owners, things, 0.2)
    assert result.tolist() == [0, 0, 1, NOBODY, 1]
    assert shares.tolist() == pytest.approx([0, 0.3, 0.4, 0, 0])


@given(st.integers(0, 2**32 - 1))
def test_holes_are_filled_and_owners_stay(seed: int) -> None:
    """Holes in a sheet close; what has an owner keeps it, and what no view sees gets none."""
    gaussians = gaussians_at(grid(1.0, 1.0, 0.1))
    before = np.zeros(len(gaussians), np.int32)
    before[np.random.default_rng(seed).choice(len(gaussians), 3, replace=False)] = NOBODY
    before[:10][before[:10] != NOBODY] = 1
    after = with_neighbors(before, gaussians, np.ones(len(gaussians), np.float32), 8)
    assert (after[20:] == 0).all() and (after != NOBODY).sum() >= (before != NOBODY).sum()
    assert (after[before != NOBODY] == before[before != NOBODY]).all()
    hidden = with_neighbors(before, gaussians, np.zeros(len(gaussians), np.float32), 8)
    assert (hidden == before).all()


def test_what_floats_far_away_joins_nothing() -> None:
    gaussians = gaussians_at(np.concatenate([grid(1.0, 1.0, 0.1), [[50.0, 0, 0], [50.0, 0, 0.1]]]))
    owners = np.zeros(len(gaussians), np.int32)
    owners[-2:] = NOBODY
    assert (with_neighbors(owners, gaussians, np.ones(len(gaussians), np.float32), 8) == owners).all()


def test_without_a_majority_nobody_owns() -> None:
    points = np.concatenate([grid(1.0, 1.0, 0.1), [[50.0, 0, 0]]])
    gaussians = gaussians_at(points)
    owners = np.arange(len(points), dtype=np.int32)
    owners[-1] = NOBODY
    assert (with_neighbors(owners, gaussians, np.ones(len(points), np.float32), 8) == owners).all()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.floats(-5, 5), st.floats(0.0, 0.4))
def test_a_plane_is_fitted_in_spite_of_what_lies_elsewhere(seed: int, offset: float, elsewhere: float) -> None:
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    points = rng.uniform(-1, 1, (600, 3))
    points += (offset - points @ normal)[:, None] * normal + rng.normal(0, 0.002, (600, 1)) * normal
    count = int(elsewhere * 600)
    points[:count] += rng.uniform(0.2, 2.0, (count, 1)) * normal
    plane = fit_plane(points, np.ones(600), seed=seed)
    assert abs(plane.normal @ normal) > 0.999
    assert plane.distance((offset * normal)[None])[0] < 0.01
    assert plane.tolerance < 0.05


def test_a_surface_grows_over_its_plane_and_no_further() -> None:
    """The views agree on half of a table; the other half joins, the same plane across the room and a box do not."""
    table, far, box = grid(1, 1, 0.04), grid(0.4, 0.4, 0.04, center=(5, 0)), grid(0.2, 0.2, 0.04, height=0.3)
    points = np.concatenate([table, far, box])
    owners = np.full(len(points), NOBODY, np.int32)
    owners[: len(table)][table[:, 0] < 0] = 0
    size = np.ones(len(points), np.float32)
    grown = grow_surfaces(owners, {0: Plane(UP, 0.0, 0.02)}, gaussians_at(points), size, 0.1)
    assert (grown[: len(table)] == 0).all() and (grown[len(table) :] == NOBODY).all()


def test_pieces_of_a_surface_join_it_and_what_lies_on_it_does_not() -> None:
    """A table, a print on it that three views of four take for a thing, and a book that is higher than the print."""
    table = grid(2, 2, 0.04)
    noise = np.random.default_rng(1).normal(0, 0.004, len(table))
    table[:, 2] = noise
    book = grid(0.4, 0.4, 0.04, height=0.05, center=(0.6, 0.6))
    points = np.concatenate([table, book])
    print_rows = np.flatnonzero((np.abs(table[:, 0] + 0.5) < 0.2) & (np.abs(table[:, 1]) < 0.2))
    rest = np.setdiff1d(np.arange(len(table)), print_rows)
    candidates = [
        candidate(rest),
        candidate(print_rows, consensus=0.75),
        candidate(np.arange(len(table), len(points)), consensus=0.7),
    ]
    size = np.ones(len(points), np.float32)
    selection = select_things(candidates, gaussians_at(points), size, SETTINGS)
    assert len(selection.things) == 2 and 0 in selection.surfaces
    assert (selection.owners[: len(table)] == 0).mean() > 0.99
    assert (selection.owners[len(table) :] == 1).all()
    assert ((selection.owners == NOBODY) == (selection.shares == 0)).all()


def test_what_nothing_else_explains_is_a_thing_though_few_views_propose_it() -> None:
    points = np.concatenate([grid(0.5, 0.5, 0.05), grid(0.5, 0.5, 0.05, height=2.0)])
    size = np.ones(len(points), np.float32)
    first, second = candidate(range(0, 100)), candidate(range(100, 200), consensus=0.3)
    inside = candidate(range(0, 60), consensus=0.3)
    selection = select_things([first, second, inside], gaussians_at(points), size, SETTINGS)
    assert [set(thing.rows.tolist()) for thing in selection.things] == [set(range(100)), set(range(100, 200))]
    assert (selection.owners == np.repeat([0, 1], 100)).all()


def test_nothing_from_nothing() -> None:
    selection = select_things([], gaussians_at(grid(1, 1, 0.2)), np.ones(25, np.float32), SETTINGS)
    assert selection.things == () and (selection.owners == NOBODY).all()


def test_surfaces_are_named_by_gravity() -> None:
    level, upright = Plane(UP, 0.0, 0.01), Plane(np.array([1.0, 0.0, 0.0]), 0.0, 0.01)
    surfaces = {0: level, 1: level, 2: level, 3: upright, 4: Plane(np.array([0.0, 0.7, 0.714]), 0.0, 0.01)}
    centers = {n: np.array([0.0, 0.0, height]) for n, height in enumerate((0.0, 0.8, 3.0, 1.0, 1.0))}
    cameras = np.array([[0.0, 0.0, 1.5], [1.0, 0.0, 1.7]])
    kinds = surface_kinds(surfaces, centers, cameras, UP)
    assert kinds == {0: "floor", 1: "horizontal surface", 2: "ceiling", 3: "wall", 4: "surface"}
    assert surface_kinds({1: level}, centers, cameras, UP) == {1: "horizontal surface"}
    assert set(surface_kinds(surfaces, centers, cameras, None).values()) == {"surface"}
