"""Parts of objects: named and asked for, while objects stay what they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.edits.prompted_objects import split_object
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Object, Parts, Scene
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat.service.scene.objects.new_objects import with_new_object
from fastsplat_contract.errors import ConflictError, InvalidInputError, NotFoundError
from fastsplat_contract.geometry.poses import pose_of
from fastsplat_contract.messages.scenes import Edit, InsertSource
from tests.query.box_scenes import BoxShell, look, orbit, scene_of, with_objects
from tests.query.conftest import opened
from tests.query.room import turned

CUP = BoxShell("mug", (0.12, 0.0, 0.06), (0.12, 0.12, 0.12), count=700)
BOOK = BoxShell("book", (-0.12, 0.0, 0.03), (0.2, 0.14, 0.06), count=400)
FRONT = look((0.0, -0.6, 0.35), (0, 0, 0.04), "front.jpg")
RIM, SPINE = 6, 8


@pytest.fixture
def scene() -> Scene:
    """A mug, object 3, whose upper half is part 6, and a book, object 5, with a spine, part 8; nothing has a name."""
    scene = scene_of([CUP, BOOK], orbit())
    count, means = len(scene.gaussians), scene.gaussians.means
    owner = np.repeat([3, 5], [CUP.count, BOOK.count])
    part = np.where((owner == 3) & (means[:, 2] > 0.06), RIM, 0)
    part = np.where((owner == 5) & (means[:, 0] < -0.18), SPINE, part)
    inside = np.flatnonzero(part)
    parts = Parts(
        (Object(RIM, parent=3, consensus=0.6), Object(SPINE, parent=5)),
        evidence_of(inside, part[inside], np.full(len(inside), 50 * UNIT), count),
    )
    return with_objects(scene, owner, (Object(3), Object(5)), parts=parts)


def edited(index: SceneIndex, *edits: Edit) -> SceneIndex:
    for edit in edits:
        index = index.after(apply_edit(index, edit, index.objects.table))
    return index


def name(object_id: int, text: str) -> Edit:
    return Edit("name", object_ids=(object_id,), name=text)


def test_lists_are_of_objects_and_have_the_parts_on_request(scene: Scene) -> None:
    objects = opened(scene).objects
    assert [(obj.id, obj.kind, obj.parts) for obj in objects.listed] == [(3, "object", (RIM,)), (5, "object", (SPINE,))]
    rows = [(obj.id, obj.kind, obj.parent) for obj in objects.listed_with_parts]
    assert rows == [(3, "object", 0), (RIM, "part", 3), (5, "object", 0), (SPINE, "part", 5)]
    for part in objects.listed_parts:
        part_rows = np.flatnonzero(objects.part_owner == part.id)
        assert part.gaussian_count == len(part_rows) and (objects.owner[part_rows] == part.parent).all()
        assert part.box is not None and objects.get(part.id) == part
        whole = objects.get(part.parent).box
        assert whole is not None and min(part.box.size) < min(whole.size)
    assert objects.names.searched.unnamed_objects == 2  # parts are nothing that a search could have missed
    object_map, part_map = objects.map(FRONT), objects.part_map(FRONT)
    assert 0.2 < (object_map[part_map > 0] > 0).mean() <= 1 and (part_map[object_map == 0] == 0).mean() > 0.99


def test_a_named_part_is_asked_for_and_is_its_own_gaussians(scene: Scene) -> None:
    index = edited(opened(scene), name(3, "mug"), name(RIM, "rim"))
    (rim, mug) = index.ask(["rim", "mug"])
    assert (rim.outcome, rim.object_ids, mug.object_ids) == ("here", (RIM,), (3,))
    np.testing.assert_array_equal(index.mask3d(rim), index.objects.part_owner == RIM)
    np.testing.assert_array_equal(index.mask3d(mug), index.objects.owner == 3)
    rim_mask = index.objects.part_map(FRONT) == RIM
    assert rim_mask.sum() > 20
    for mask in (index.mask(rim, FRONT), index.mask2d(rim, FRONT).mask):
        np.testing.assert_array_equal(mask, rim_mask)
    (item,) = index.objects_of(rim)
    assert (item.id, item.name, item.gaussian_count) == (RIM, "rim", int((index.objects.part_owner == RIM).sum()))
    labels = {entry.label: number for number, entry in enumerate(index.scene.dictionary.entries, start=1)}
    assert index.label_counts[labels["rim"]] == (index.objects.part_owner == RIM).sum()
    assert index.label_counts[labels["mug"]] == CUP.count
    both = edited(index, name(SPINE, "mug"))
    (mug,) = both.ask(["mug"])
    assert mug.object_ids == (3, SPINE)
    np.testing.assert_array_equal(both.mask3d(mug), (both.objects.owner == 3) | (both.objects.part_owner == SPINE))
    assert (both.mask2d(mug, FRONT).mask == both.mask(mug, FRONT)).all()
    (gone,) = edited(both, Edit("unname", label="mug")).ask(["mug"])
    assert gone.outcome == "cannot_say" and 3 in gone.object_ids


def test_what_a_person_named_is_guarded_for_parts_too(scene: Scene) -> None:
    before = opened(scene)
    after = edited(before, name(RIM, "rim"))
    with pytest.raises(ConflictError, match="has named object 6"):
        apply_edit(after, name(RIM, "lip"), before.objects.table)
    assert (edited(after, name(RIM, "lip")).objects.get(RIM).name, after.objects.get(RIM).name) == ("lip", "rim")


def test_edits_of_what_is_seen_take_the_gaussians_of_a_part(scene: Scene) -> None:
    index = opened(scene)
    count, rim = len(scene.gaussians), index.objects.part_owner == RIM
    removed = edited(index, Edit("remove", object_ids=(RIM,)))
    assert count - len(removed.scene.gaussians) >= rim.sum()
    assert [obj.id for obj in removed.objects.listed_with_parts] == [3, 5, SPINE]
    with pytest.raises(NotFoundError):
        removed.objects.get(RIM)
    red = edited(index, Edit("recolor", object_ids=(RIM,), color=(1, 0, 0))).scene.gaussians.sh
    changed = (red != scene.gaussians.sh).any(axis=(1, 2))
    assert changed[rim].all() and not changed[index.objects.owner == 5].any()


def test_merging_and_discarding_keep_parts_where_their_objects_stay(scene: Scene) -> None:
    index = opened(scene)
    merged = edited(index, Edit("merge", object_ids=(5, 3)))
    assert [(part.id, part.parent) for part in merged.objects.listed_parts] == [(RIM, 5), (SPINE, 5)]
    np.testing.assert_array_equal(merged.objects.part_owner, index.objects.part_owner)
    without = edited(index, Edit("discard", object_ids=(RIM,)))
    assert [obj.id for obj in without.objects.listed_with_parts] == [3, 5, SPINE]
    np.testing.assert_array_equal(without.objects.owner, index.objects.owner)
    alone = edited(index, Edit("discard", object_ids=(3, RIM)))
    assert [obj.id for obj in alone.objects.listed_with_parts] == [5, SPINE]
    bare = edited(index, Edit("discard", object_ids=(3, 5)))
    assert bare.scene.objects == replace(bare.scene.objects, table=(), parts=None)
    with pytest.raises(InvalidInputError, match="a part of object 3"):
        apply_edit(index, Edit("merge", object_ids=(5, RIM)))


def test_copies_have_new_ids_and_no_parts(scene: Scene) -> None:
    index = opened(scene)
    aside = pose_of(turned(0, 1.0))
    copied = edited(index, Edit("duplicate", object_ids=(3,), transform=aside))
    assert [obj.id for obj in copied.objects.listed_with_parts] == [3, RIM, 5, SPINE, SPINE + 1]
    np.testing.assert_array_equal(copied.objects.part_owner[len(scene.gaussians) :], 0)
    insert = Edit("insert", object_ids=(3,), transform=aside, source=InsertSource("s"))
    inserted = index.after(apply_edit(index, insert, source=opened(scene)))
    assert [obj.id for obj in inserted.objects.listed_with_parts] == [3, RIM, 5, SPINE, SPINE + 1]
    with pytest.raises(InvalidInputError, match="a part of object 3"):
        apply_edit(index, replace(insert, object_ids=(RIM,)), source=opened(scene))


def test_what_is_carried_over_an_edit_is_what_a_fresh_look_says(scene: Scene) -> None:
    index = opened(scene)
    index.objects.map(FRONT), index.objects.part_map(FRONT)
    both, unnamed = Edit("name", object_ids=(5, 3), name="cup"), Edit("unname", object_ids=(5,))
    merged = Edit("discard", object_ids=(SPINE,)), Edit("merge", object_ids=(5, 3))
    for edit in (name(3, "mug"), name(RIM, "rim"), both, unnamed, *merged, name(5, "book")):
        index = edited(index, edit)
        fresh = opened(index.scene)
        assert index.objects.listed_with_parts == fresh.objects.listed_with_parts
        np.testing.assert_array_equal(index.objects.map(FRONT), fresh.objects.map(FRONT))
        np.testing.assert_array_equal(index.objects.part_map(FRONT), fresh.objects.part_map(FRONT))
    assert {obj.id: obj.name for obj in index.objects.listed_with_parts} == {5: "book", RIM: "rim"}


def test_parts_come_back_as_they_were_written(scene: Scene, tmp_path: Path) -> None:
    named = edited(opened(scene), name(RIM, "rim"))
    write_scene(named.scene, tmp_path / "v")
    assert (tmp_path / "v" / "parts.safetensors").is_file()
    again = opened(read_scene(tmp_path / "v"))
    assert again.objects.listed_with_parts == named.objects.listed_with_parts
    np.testing.assert_array_equal(again.objects.part_owner, named.objects.part_owner)
    assert again.ask(["rim"])[0].object_ids == (RIM,)


def test_what_becomes_another_object_leaves_the_parts_of_its_old_one(scene: Scene) -> None:
    taken = np.flatnonzero(opened(scene).objects.part_owner == RIM)[::2]
    changed, new_id = with_new_object(scene, taken)
    before, after = opened(scene).objects, opened(changed).objects
    assert new_id == SPINE + 1 and (np.flatnonzero(after.owner == new_id) == taken).all()
    assert not after.part_owner[taken].any()
    rest = np.setdiff1d(np.arange(len(scene.gaussians)), taken)
    np.testing.assert_array_equal(after.part_owner[rest], before.part_owner[rest])
    np.testing.assert_array_equal(after.owner[rest], before.owner[rest])


def test_a_part_is_not_split(scene: Scene) -> None:
    with pytest.raises(InvalidInputError, match=f"{RIM} is a part of object 3"):
        split_object(opened(scene), Edit("split", object_ids=(RIM,)))
