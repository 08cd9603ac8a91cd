"""The levels of a place: a part, its object and the group, each with the probability that it is meant."""

from __future__ import annotations

from collections.abc import Callable
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.objects.picking import chosen_level, pick_box, pick_pixel, pick_point
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Object, ObjectGroup, Parts, Scene
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.geometry.poses import Vector3
from fastsplat_contract.messages.objects import PickedLevel, PickLevel, Pixel, PixelBox
from fastsplat_contract.messages.scenes import Edit
from tests.query.box_scenes import BoxShell, look, orbit, scene_of, with_objects
from tests.query.conftest import opened

CUP = BoxShell("mug", (0.12, 0.0, 0.06), (0.12, 0.12, 0.12), count=700)
BOOK = BoxShell("book", (-0.12, 0.0, 0.03), (0.2, 0.14, 0.06), count=400)
FRONT = look((0.0, -0.6, 0.35), (0, 0, 0.04), "front.jpg")
MUG, SPREAD, HALF, BOTH = 3, 5, 6, 9


def scene_with(**changes: float) -> Scene:
    """A mug, object 3, whose upper half is part 6, and a book, object 5, in group 9; consensus .8 but by level."""
    consensus = {"object": 0.8, "part": 0.8, "group": 0.8, **changes}
    scene = scene_of([CUP, BOOK], orbit())
    count = len(scene.gaussians)
    owner = np.repeat([MUG, SPREAD], [CUP.count, BOOK.count])
    upper = np.flatnonzero((owner == MUG) & (scene.gaussians.means[:, 2] > 0.06))
    parts = Parts(
        (Object(HALF, parent=MUG, consensus=consensus["part"]),),
        evidence_of(upper, np.full(len(upper), HALF), np.full(len(upper), 50 * UNIT), count),
    )
    groups = (ObjectGroup(BOTH, (MUG, SPREAD), consensus["group"]),)
    objects = [Object(number, consensus=consensus["object"]) for number in (MUG, SPREAD)]
    return with_objects(scene, owner, objects, parts=parts, groups=groups)


def pixel_of(index: SceneIndex, inside: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Pixel:
    """The middle one of the pixels that are so, by the maps of objects and of parts."""
    rows, columns = np.nonzero(inside(index.objects.map(FRONT), index.objects.part_map(FRONT)))
    middle = np.argmin((rows - rows.mean()) ** 2 + (columns - columns.mean()) ** 2)
    return Pixel(columns[middle] + 0.5, rows[middle] + 0.5)


def test_every_way_to_pick_answers_all_levels_and_the_probabilities_add_up() -> None:
    index = opened(scene_with())
    objects = index.objects
    rows, columns = np.nonzero(objects.map(FRONT) == MUG)
    box = PixelBox(columns.min(), rows.min(), columns.max() + 1.0, rows.max() + 1.0)
    point = Vector3(*index.scene.gaussians.means[objects.part_owner == HALF][0].tolist())
    pixel = pixel_of(index, lambda whole, parts: (whole == MUG) & (parts == HALF))
    for levels in (pick_pixel(objects, FRONT, pixel), pick_box(objects, FRONT, box), pick_point(objects, point)):
        assert [(level.level, level.id) for level in levels] == [("part", HALF), ("object", MUG), ("group", BOTH)]
        assert sum(level.probability for level in levels) == pytest.approx(1)
        assert [level.members for level in levels] == [(), (), (MUG, SPREAD)]
        assert chosen_level(levels, "likeliest").level == "object"
        assert [chosen_level(levels, level).level for level in get_args(PickLevel)] == list(get_args(PickLevel))


def test_a_level_that_is_not_there_is_refused() -> None:
    index = opened(scene_with())
    lower = pixel_of(index, lambda whole, parts: (whole == MUG) & (parts == 0))
    levels = pick_pixel(index.objects, FRONT, lower)
    assert [level.level for level in levels] == ["object", "group"]
    with pytest.raises(NotFoundError, match="no part at this place") as raised:
        chosen_level(levels, "part")
    assert raised.value.field == "level"


def test_more_consensus_and_more_agreement_make_a_level_likelier() -> None:
    upper = pixel_of(opened(scene_with()), lambda whole, parts: (whole == MUG) & (parts == HALF))

    def probabilities(index: SceneIndex, pixel: Pixel = upper) -> dict[str, float]:
        return {level.level: level.probability for level in pick_pixel(index.objects, FRONT, pixel)}

    usual = probabilities(opened(scene_with()))
    for level in get_args(PickLevel):
        less = probabilities(opened(scene_with(**{level: 0.4})))
        assert less[level] < usual[level]
        assert all(less[other_level] > usual[other_level] for other_level in usual if other_level != level)
    index = opened(scene_with())
    whole, parts = index.objects.map(FRONT), index.objects.part_map(FRONT)
    edge = parts[1:] != parts[:-1]
    rows, columns = np.nonzero((parts[:-1] == HALF) & (whole[:-1] == MUG) & edge & (whole[1:] == MUG))
    at_the_edge = probabilities(index, Pixel(columns[0] + 0.5, rows[0] + 0.5))
    assert at_the_edge["part"] < usual["part"]


def test_the_part_that_fits_a_box_is_likelier_there_than_at_the_whole() -> None:
    objects = opened(scene_with()).objects

    def part(mask: np.ndarray) -> float:
        rows, columns = np.nonzero(mask)
        box = PixelBox(columns.min(), rows.min(), columns.max() + 1.0, rows.max() + 1.0)
        return next(level.probability for level in pick_box(objects, FRONT, box) if level.level == "part")

    assert part(objects.mask(FRONT, (HALF,))) > part(objects.mask(FRONT, (MUG,)))


def test_a_group_is_its_members_in_masks_and_rows() -> None:
    objects = opened(scene_with()).objects
    np.testing.assert_array_equal(objects.mask(FRONT, (BOTH,)), objects.mask(FRONT, (MUG, SPREAD)))
    np.testing.assert_array_equal(objects.rows((BOTH,)), objects.rows((MUG, SPREAD)))
    assert objects.with_members((HALF, BOTH, MUG)) == (HALF, MUG, SPREAD)
    assert [obj.groups for obj in objects.listed] == [(BOTH,), (BOTH,)]
    with pytest.raises(NotFoundError, match="no object 77"):
        objects.with_members((BOTH, 77))


def test_a_group_of_what_is_gone_is_none_and_comes_back_with_it() -> None:
    before = opened(scene_with())
    after = before.after(apply_edit(before, Edit("remove", object_ids=(SPREAD,))))
    pixel = pixel_of(after, lambda whole, parts: (whole == MUG) & (parts == 0))
    assert [level.level for level in pick_pixel(after.objects, FRONT, pixel)] == ["object"]
    assert after.objects.groups == {} and after.objects.get(MUG).groups == ()
    merged = before.after(apply_edit(before, Edit("merge", object_ids=(MUG, SPREAD))))
    assert merged.objects.groups == {} and merged.objects.table.groups == ()
    assert opened(before.scene).objects.groups[BOTH].members == (MUG, SPREAD)


_SHARES = st.floats(0, 1)


@given(st.lists(_SHARES, min_size=3, max_size=3))
def test_the_likeliest_is_the_most_probable_and_of_equals_the_object(shares: list[float]) -> None:
    levels = [PickedLevel(level, 1, (), share) for level, share in zip(get_args(PickLevel), shares, strict=True)]
    chosen = chosen_level(levels, "likeliest")
    assert chosen.probability == max(shares)
    if shares[1] == max(shares):
        assert chosen.level == "object"
