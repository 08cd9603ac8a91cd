"""Groups are of objects that views took for one, as the objects are in the end."""

from __future__ import annotations

import numpy as np

from fastsplat.service.instances.discovery.discovery import find_groups, select_objects
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.scene.artefact.scene import ObjectGroup
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
