"""Parts and groups are none of the objects, surfaces are whole, and every Gaussian has one owner at most."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fastsplat.service.instances.discovery.discovery import find_groups, find_hierarchy, find_parts, select_objects
from fastsplat.service.instances.discovery.ownership import NOBODY, assign_owners, with_neighbors, without_strays
from fastsplat.service.instances.discovery.surfaces import Plane, fit_plane, join_surfaces, lies_in, surface_kinds
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.scene.artefact.scene import Object, ObjectGroup, Objects, Parts
from fastsplat.service.scene.objects.label_evidence import no_evidence
from fastsplat.service.scene.objects.objects import part_rows
from tests.instances.known_objects import candidate, gaussians_at, grid

SETTINGS = DiscoverySettings(min_weight_px=5)
UP = np.array([0.0, 0.0, 1.0])


def test_parts_objects_and_groups() -> None:
    size = np.ones(400, np.float32)
    cup, handle = candidate(range(0, 100), support=0.9), candidate(range(80, 100), support=0.65)
    plate, both = candidate(range(100, 200), support=0.95), candidate(range(0, 200), support=0.7)
    rare = candidate(range(300, 400), support=0.3)
    hierarchy = find_hierarchy([cup, handle, plate, both, rare], size, SETTINGS)
    assert set(hierarchy.objects) == {0, 2}
    assert hierarchy.part_of == {1: 0}
    assert {group: set(members) for group, members in hierarchy.groups.items()} == {3: {0, 2}}


@pytest.mark.parametrize("support", [0.4, 0.6, 0.8, 0.95])
def test_a_whole_is_a_group_if_what_it_consists_of_is_better_supported(support: float) -> None:
    """Two halves of a whole; a tie goes to the whole."""
    size = np.ones(100, np.float32)
    halves = [candidate(range(50), support=0.8), candidate(range(50, 100), support=0.8)]
    hierarchy = find_hierarchy([*halves, candidate(range(100), support=support)], size, SETTINGS)
    assert (set(hierarchy.groups) == {2}) == (support < 0.8) == (2 not in hierarchy.objects)
    assert support < 0.9 or hierarchy.part_of == {0: 2, 1: 2}


def test_what_has_a_sharper_edge_than_the_object_it_lies_in_is_an_object_of_its_own() -> None:
    """An apple in a bowl, each with a part: its leaf, its pattern."""
    size = np.ones(100, np.float32)
    bowl, apple = candidate(range(0, 100), support=0.8), candidate(range(0, 20), support=0.75)
    leaf, pattern = candidate(range(0, 6), support=0.5), candidate(range(40, 70), support=0.6)
    hierarchy = find_hierarchy([bowl, apple, leaf, pattern], size, SETTINGS)
    assert hierarchy.objects == (0, 1) and hierarchy.part_of == {2: 1, 3: 0} and hierarchy.groups == {}


@pytest.mark.parametrize(("proposed", "is_object"), [(1, False), (3, False), (4, True), (10, True)])
def test_what_most_views_do_not_propose_is_no_object(proposed: int, is_object: bool) -> None:
    """However well the masks of the others happen to fit; in an object it is a part, of the smallest that has it."""
    size = np.ones(200, np.float32)
    table, plate = candidate(range(0, 100), support=0.9), candidate(range(0, 40), support=0.95)
    alone = candidate(range(120, 150), support=0.9, proposed=proposed, missed=10 - proposed)
    inside = candidate(range(0, 20), support=0.6, proposed=proposed, missed=10 - proposed)
    hierarchy = find_hierarchy([table, plate, alone, inside], size, SETTINGS)
    assert set(hierarchy.objects) == ({0, 1, 2} if is_object else {0, 1})
    assert hierarchy.part_of == {3: 1}


def test_parts_of_parts_are_parts_of_the_object() -> None:
    size = np.ones(100, np.float32)
    chain = [candidate(range(length), support=0.4 + 0.005 * length) for length in (10, 30, 60, 100)]
    assert find_hierarchy(chain, size, SETTINGS).part_of == {0: 3, 1: 3, 2: 3}


def test_what_lies_in_two_members_of_a_group_counts_once() -> None:
    """Two overlapping halves cover half of a wall twice: that is no reason to take it apart."""
    size = np.ones(100, np.float32)
    halves = [candidate(range(0, 55), support=0.75), candidate(range(5, 60), support=0.75)]
    wall = candidate(range(100), support=0.8)
    hierarchy = find_hierarchy([*halves, wall], size, SETTINGS)
    assert 2 in hierarchy.objects and hierarchy.groups == {}


@settings(max_examples=100, derandomize=True)
@given(
    st.lists(st.tuples(st.integers(0, 90), st.integers(1, 60), st.floats(0, 1)), max_size=10),
    st.randoms(use_true_random=False),
)
def test_every_candidate_is_one_of_object_part_and_group(spans: list[tuple[int, int, float]], random) -> None:
    """Or too small or too little supported; the order of candidates does not matter where no two weigh the same."""
    size = np.ones(100, np.float32)
    by_weight = {length: (start, length, support) for start, length, support in spans if start + length <= 100}
    candidates = [candidate(range(s, s + length), support=support) for s, length, support in by_weight.values()]
    hierarchy = find_hierarchy(candidates, size, SETTINGS)
    kinds = [*hierarchy.objects, *hierarchy.part_of, *hierarchy.groups]
    assert len(kinds) == len(set(kinds))
    for number, piece in enumerate(candidates):
        better = any(rival.support > piece.support for rival in candidates)
        assert number in kinds or piece.weight < 5 or piece.support < 0.36 or better
    assert set(hierarchy.part_of.values()) <= set(hierarchy.objects)
    assert all(len(members) >= 2 for members in hierarchy.groups.values())
    weights = [candidates[obj].weight for obj in hierarchy.objects]
    assert weights == sorted(weights, reverse=True)
    order = random.sample(range(len(candidates)), len(candidates))
    again = find_hierarchy([candidates[number] for number in order], size, SETTINGS)
    assert [order[obj] for obj in again.objects] == list(hierarchy.objects)
    assert {order[part]: order[obj] for part, obj in again.part_of.items()} == hierarchy.part_of


@settings(max_examples=40)
@given(st.lists(st.tuples(st.integers(0, 90), st.integers(1, 40)), max_size=8))
def test_the_smallest_object_owns(spans: list[tuple[int, int]]) -> None:
    objects = [
        candidate(range(start, min(100, start + length)), share=0.5 + 0.01 * n)
        for n, (start, length) in enumerate(spans)
    ]
    owners, shares = assign_owners(objects, 100)
    for row in range(100):
        having = [n for n, obj in enumerate(objects) if row in obj.rows]
        if not having:
            assert owners[row] == NOBODY and shares[row] == 0
        else:
            assert objects[owners[row]].weight == min(objects[n].weight for n in having)
            assert shares[row] == pytest.approx(objects[owners[row]].shares[0])


def test_strays_are_left_out_and_whole_objects_stay() -> None:
    points = np.concatenate([grid(1, 1, 0.05), grid(0.1, 0.1, 0.05, height=5.0)])
    owners = np.zeros(len(points), np.int32)
    left = without_strays(owners, gaussians_at(points), np.ones(len(points), np.float32), 0.1)
    assert (left[:400] == 0).all() and (left[400:] == NOBODY).all()


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


@pytest.mark.parametrize(("objects", "far"), [(1, 2), (100, 1)], ids=["far away", "without a majority"])
def test_what_floats_far_away_or_has_no_majority_around_it_joins_nothing(objects: int, far: int) -> None:
    gaussians = gaussians_at(np.concatenate([grid(1.0, 1.0, 0.1), [[50.0, 0, 0.1 * n] for n in range(far)]]))
    owners = np.arange(len(gaussians), dtype=np.int32) % objects
    owners[-far:] = NOBODY
    assert (with_neighbors(owners, gaussians, np.ones(len(gaussians), np.float32), 8) == owners).all()


@settings(max_examples=25)
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


def test_a_surface_has_its_plane_as_far_as_it_is_connected() -> None:
    """The views agree on half of a table; the other half joins, the same plane across the room and a box do not."""
    table, far, box = grid(1, 1, 0.04), grid(0.4, 0.4, 0.04, center=(5, 0)), grid(0.2, 0.2, 0.04, height=0.3)
    points = np.concatenate([table, far, box])
    half = np.flatnonzero(table[:, 0] < 0)
    owners = np.full(len(points), NOBODY, np.int32)
    owners[half] = 0
    size = np.ones(len(points), np.float32)
    joined = join_surfaces(owners, [candidate(half)], {0: Plane(UP, 0.0, 0.02)}, gaussians_at(points), size)
    assert (joined[: len(table)] == 0).all() and (joined[len(table) :] == NOBODY).all()


@pytest.mark.parametrize(("included", "support"), [(True, 0.75), (False, 0.75), (False, 0.4)])
def test_pieces_of_a_surface_join_it_and_what_lies_on_it_does_not(included: bool, support: float) -> None:
    """A table, a flat object on it (a print if the table's masks include it, else a ruler), and a higher book."""
    table = grid(2, 2, 0.04)
    noise = np.random.default_rng(1).normal(0, 0.004, len(table))
    table[:, 2] = noise
    book = grid(0.4, 0.4, 0.04, height=0.05, center=(0.6, 0.6))
    points = np.concatenate([table, book])
    print_rows = np.flatnonzero((np.abs(table[:, 0] + 0.5) < 0.2) & (np.abs(table[:, 1]) < 0.2))
    rest = np.setdiff1d(np.arange(len(table)), print_rows)
    candidates = [
        candidate(np.arange(len(table)) if included else rest, support=0.9),
        candidate(print_rows, support=support),
        candidate(np.arange(len(table), len(points)), support=0.5),
    ]
    size = np.ones(len(points), np.float32)
    selection = select_objects(candidates, gaussians_at(points), size, SETTINGS)
    book_number = int(selection.owners[-1])
    is_print = included or support < 0.45
    assert len(selection.objects) == (2 if is_print else 3) and 0 in selection.surfaces
    assert (selection.owners[rest] == 0).mean() > 0.99
    assert (selection.owners[print_rows] == 0).all() == is_print
    assert selection.objects[book_number].support == 0.5 and (selection.owners[len(table) :] == book_number).all()
    assert ((selection.owners == NOBODY) == (selection.shares == 0)).all()


@pytest.mark.parametrize(("height", "is_object"), [(-0.7, True), (0.3, True), (0.0, False)])
def test_what_lies_off_the_plane_of_a_surface_is_no_part_of_it(height: float, is_object: bool) -> None:
    """A table whose masks have the floor, too, and would have a lit patch of it, which stays a part."""
    table = grid(2, 2, 0.04)
    table[:, 2] = np.random.default_rng(2).normal(0, 0.004, len(table))
    points = np.concatenate([table, grid(1, 1, 0.04, height=height, center=(1.5, 0))])
    patch = np.arange(len(table), len(points))
    candidates = [candidate(range(len(points)), support=0.9), candidate(patch, support=0.6)]
    selection = select_objects(candidates, gaussians_at(points), np.ones(len(points), np.float32), SETTINGS)
    assert len(selection.objects) == (2 if is_object else 1) and len(selection.parts) == (not is_object)
    assert (selection.owners[: len(table)] == 0).all() and (selection.owners[patch] == int(is_object)).all()


def test_a_plate_on_a_table_does_not_spread_over_the_table() -> None:
    """Nobody owns a ring of the table around a plate, which lies nearly in the table's plane: the table has it."""
    table = grid(2, 2, 0.04)
    middle = np.abs(table[:, :2]).max(axis=1)
    plate_rows, ring = np.flatnonzero(middle < 0.3), np.flatnonzero((middle >= 0.3) & (middle < 0.4))
    owners = np.zeros(len(table), np.int32)
    owners[plate_rows], owners[ring] = 1, NOBODY
    objects = [candidate(np.flatnonzero(middle >= 0.4)), candidate(plate_rows)]
    planes = {0: Plane(UP, 0.0, 0.02), 1: Plane(UP, 0.0, 0.02)}
    joined = join_surfaces(owners, objects, planes, gaussians_at(table), np.ones(len(table), np.float32))
    assert (joined[ring] == 0).all() and (joined[plate_rows] == 1).all()


def test_nothing_from_nothing() -> None:
    selection = select_objects([], gaussians_at(grid(1, 1, 0.2)), np.ones(25, np.float32), SETTINGS)
    assert selection.objects == () and (selection.owners == NOBODY).all()


def test_surfaces_are_named_by_gravity() -> None:
    level, upright = Plane(UP, 0.0, 0.01), Plane(np.array([1.0, 0.0, 0.0]), 0.0, 0.01)
    surfaces = {0: level, 1: level, 2: level, 3: upright, 4: Plane(np.array([0.0, 0.7, 0.714]), 0.0, 0.01)}
    centers = {n: np.array([0.0, 0.0, height]) for n, height in enumerate((0.0, 0.8, 3.0, 1.0, 1.0))}
    cameras = np.array([[0.0, 0.0, 1.5], [1.0, 0.0, 1.7]])
    kinds = surface_kinds(surfaces, centers, cameras, UP)
    assert kinds == {0: "floor", 1: "horizontal surface", 2: "ceiling", 3: "wall", 4: "surface"}
    assert surface_kinds({1: level}, centers, cameras, UP) == {1: "horizontal surface"}
    assert set(surface_kinds(surfaces, centers, cameras, None).values()) == {"surface"}


@pytest.mark.parametrize(("height", "lies"), [(0.0, True), (0.2, True), (0.4, False), (0.7, False)])
def test_a_print_lies_in_the_plane_of_a_table_and_what_lies_on_it_does_not(height: float, lies: bool) -> None:
    """Heights in tolerances of the plane: a knife's middle is within half of one, and yet too high."""
    points = grid(0.2, 0.2, 0.02, height=0.05 * height)
    rows = np.arange(len(points), dtype=np.int32)
    assert lies_in(Plane(UP, 0.0, 0.05), rows, gaussians_at(points), np.ones(len(points), np.float32)) == lies


def test_members_are_objects_that_lie_in_the_group() -> None:
    owners = np.repeat([0, 1, 2, -1], [60, 30, 20, 10]).astype(np.int32)
    size = np.ones(len(owners), np.float32)
    groups = (
        candidate(range(60, 110), proposed=2, missed=2),
        candidate([*range(60, 120)], proposed=7, missed=3),  # the same members, by more views
        candidate(range(30, 90), support=0.9, proposed=9, missed=1),  # half of one object and one whole: no two objects
        candidate(range(0, 90), proposed=4, missed=1),
    )
    found = find_groups(groups, owners, size, 7)
    assert found == (ObjectGroup(7, (1, 2), 0.8), ObjectGroup(8, (2, 3), 0.7))
    assert find_groups(groups, np.zeros(len(owners), np.int32), size, 7) == ()


def rows_of(parts: Parts, gaussians: int) -> np.ndarray:
    table = tuple(Object(number) for number in sorted({part.parent for part in parts.table}))
    return part_rows(Objects(table, no_evidence(gaussians), 0, parts))


def test_a_sure_part_is_kept_with_its_object_and_several_objects_are_a_group() -> None:
    points = np.concatenate([grid(1, 1, 0.1), grid(1, 1, 0.1, height=3.0)])
    half, size = len(points) // 2, np.ones(len(points), np.float32)
    table = candidate(range(half), support=0.9, proposed=9, missed=1)
    lamp = candidate(range(half, 2 * half), support=0.95, proposed=19, missed=1)
    corner = candidate(range(half + 4, half + 24), support=0.65, proposed=13, missed=7, share=0.75)
    stack = candidate(range(2 * half), support=0.6, proposed=3, missed=2)
    selection = select_objects([lamp, table, corner, stack], gaussians_at(points), size, SETTINGS)
    assert len(selection.objects) == 2 and selection.groups == (stack,)
    assert find_groups(selection.groups, selection.owners, size, 3) == (ObjectGroup(3, (1, 2), 0.6),)
    parts = find_parts(selection.parts, selection.owners, size, SETTINGS, 3)
    assert parts is not None
    (part,) = parts.table
    assert (part.id, part.consensus) == (3, 0.65) and selection.objects[part.parent - 1] is lamp
    np.testing.assert_array_equal(np.flatnonzero(rows_of(parts, len(points)) == 3), corner.rows)


def test_parts_are_of_what_their_object_owns_and_the_smaller_has_what_two_claim() -> None:
    owners = np.repeat([0, 1, -1], [100, 50, 10]).astype(np.int32)
    size = np.ones(len(owners), np.float32)
    claims = (
        (candidate(range(40, 110), share=0.6), 0),  # ten of them are of the other object
        (candidate(range(50, 70), share=0.9), 0),
        (candidate(range(48, 72), share=0.7), 0),  # too little of it is left
        (candidate(range(100, 148)), 1),  # nearly all of its object
        (candidate(range(100, 103)), 1),  # too small
    )
    parts = find_parts(claims, owners, size, SETTINGS, 7)
    assert parts is not None and [(part.id, part.parent) for part in parts.table] == [(7, 1), (8, 1)]
    expected = np.zeros(len(owners), np.int32)
    expected[40:100], expected[50:70] = 7, 8
    np.testing.assert_array_equal(rows_of(parts, len(owners)), expected)
    assert find_parts((), owners, size, SETTINGS, 7) is None
