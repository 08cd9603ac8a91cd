"""Objects of one scene in another: they look, and answer to their names, as they did."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.poses import pose_of
from fastsplat_contract.messages.scenes import Edit, InsertSource
from tests.query.box_scenes import orbit, rigid, scene_of
from tests.query.conftest import opened
from tests.query.edits.test_edits import BOOK, FRONT, MUG
from tests.query.room import turned
from tests.scenes import evidence_from_dense

SOURCE = InsertSource("s")


def insert(pose: np.ndarray, **target: Any) -> Edit:
    return Edit("insert", transform=pose_of(pose), source=SOURCE, **target)


@pytest.mark.parametrize(("here", "there"), [(2, 2), (1, 3), (3, 0)])
def test_an_inserted_object_is_the_object_moved(here: int, there: int) -> None:
    target = opened(scene_of([BOOK], orbit(), degree=here))
    source = opened(scene_of([replace(MUG, label="cup"), replace(MUG, label="lid", centre=(5, 5, 5))], degree=there))
    pose = rigid(3)
    pose[:3, 3] = (0.0, 0.0, 0.3)
    after = apply_edit(target, insert(pose, label="cup"), source=source)
    count = len(target.scene.gaussians)
    assert len(after.gaussians) == count + MUG.count and after.gaussians.sh_degree == here
    moved = apply_edit(source, Edit("move", label="cup", transform=pose_of(pose)))
    for name in ("means", "quats", "log_scales", "logit_opacities"):
        np.testing.assert_array_equal(
            getattr(after.gaussians, name)[count:], getattr(moved.gaussians, name)[: MUG.count], err_msg=name
        )
        np.testing.assert_array_equal(getattr(after.gaussians, name)[:count], getattr(target.scene.gaussians, name))
    shared = min(after.gaussians.sh.shape[1], moved.gaussians.sh.shape[1])
    np.testing.assert_array_equal(after.gaussians.sh[count:, :shared], moved.gaussians.sh[: MUG.count, :shared])
    assert not after.gaussians.sh[count:, shared:].any()
    index = opened(after)
    assert [(obj.id, obj.name) for obj in index.objects.listed] == [(1, "book"), (2, "cup")]
    (cup, book) = index.ask(["cup", "book"])
    assert cup.outcome == book.outcome == "here" and (cup.object_ids, book.object_ids) == ((2,), (1,))
    np.testing.assert_array_equal(np.flatnonzero(index.mask3d(cup)), np.arange(count, count + MUG.count))
    alone = opened(apply_edit(index, Edit("remove", object_ids=(1,))))
    rest = opened(apply_edit(opened(moved), Edit("remove", label="lid")))
    if here == there:
        np.testing.assert_array_equal(alone.render(FRONT), rest.render(FRONT))


def test_an_object_comes_again_under_new_ids_and_one_label() -> None:
    scene = scene_of([MUG, BOOK], orbit())
    sums = 4.0 * np.eye(3)[opened(scene).gaussian_classes]
    scene = replace(scene, evidence=evidence_from_dense(sums))
    index = opened(scene)
    for ids in ((1, 2), (1, 2, 3)):
        index = opened(apply_edit(index, insert(turned(0, z=1.0), object_ids=(1,)), source=opened(scene)))
        (mugs,) = index.ask(["mugs"])
        assert mugs.object_ids == tuple(i for i in (*ids, max(ids) + 1) if i != 2)
    assert len(index.scene.dictionary) == 2 and len(index.scene.evidence or ()) == len(index.scene.gaussians)


def test_what_cannot_be_inserted_is_refused() -> None:
    index = opened(scene_of([MUG], orbit()))
    source = opened(scene_of([BOOK], orbit()))
    with pytest.raises(NotFoundError, match="mug"):
        apply_edit(index, insert(np.eye(4), label="mug"), source=source)
    with pytest.raises(InvalidInputError, match="source"):
        apply_edit(index, Edit("insert", label="book", transform=pose_of(np.eye(4))), source=source)
    with pytest.raises(InvalidInputError, match="source"):
        apply_edit(index, Edit("remove", label="mug", source=SOURCE))
    with pytest.raises(InvalidInputError, match="transform"):
        apply_edit(index, Edit("insert", label="book", source=SOURCE), source=source)
    without_unit = opened(replace(source.scene, scale="ARBITRARY"))
    with pytest.raises(InvalidInputError, match="scale"):
        apply_edit(index, insert(np.eye(4), label="book"), source=without_unit)
