"""Groups are of objects that views took for one; candidates that are parts stay as parts of their objects."""

from __future__ import annotations

import numpy as np

from fastsplat.service.instances.discovery.discovery import find_groups, find_parts, select_objects
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.scene.artefact.scene import Object, ObjectGroup, Objects, Parts
from fastsplat.service.scene.objects.label_evidence import no_evidence
from fastsplat.service.scene.objects.objects import part_rows
from tests.instances.known_objects import candidate, gaussians_at, grid

SETTINGS = DiscoverySettings(min_weight_px=5)


def test_what_the_hierarchy_takes_for_several_objects_is_a_group_of_them() -> None:
    points = np.concatenate([grid(1, 1, 0.1), grid(1, 1, 0.1, height=3.0)])
    half, size = len(points) // 2, np.ones(len(points), np.float32)
    lower, upper = (
        candidate(range(half), support=0.9, proposed=9, missed=1),
        candidate(range(half, 2 * half), support=0.95, proposed=19, missed=1),
    )
    stack = candidate(range(2 * half), support=0.6, proposed=3, missed=2)
    selection = select_objects([upper, lower, stack], gaussians_at(points), size, SETTINGS)
    assert len(selection.objects) == 2 and selection.groups == (stack,)
    assert find_groups(selection.groups, selection.owners, size, 3) == (ObjectGroup(3, (1, 2), 0.6),)


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


def test_a_sure_part_of_an_object_is_kept_with_its_parent() -> None:
    points = np.concatenate([grid(1, 1, 0.1), grid(1, 1, 0.1, height=3.0)])
    half, size = len(points) // 2, np.ones(len(points), np.float32)
    table, lamp = candidate(range(half), support=0.9), candidate(range(half, 2 * half), support=0.95)
    corner = candidate(range(half + 4, half + 24), support=0.65, proposed=13, missed=7, share=0.75)
    selection = select_objects([lamp, table, corner], gaussians_at(points), size, SETTINGS)
    assert len(selection.objects) == 2
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


def test_objects_without_parts_have_none() -> None:
    owners = np.zeros(10, np.int32)
    assert find_parts((), owners, np.ones(10, np.float32), SETTINGS, 2) is None
