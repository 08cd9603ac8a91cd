"""Parts of things: found under a click, named and asked for, while things stay what they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.edits.prompted_things import split_thing
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.things.picking import pick_pixel, pick_point
from fastsplat.service.scene.artefact.scene import Parts, Scene, Thing, Things
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat.service.scene.objects.new_things import with_new_thing
from fastsplat_contract.errors import ConflictError, InvalidInputError, NotFoundError
from fastsplat_contract.geometry.poses import Vector3, pose_of
from fastsplat_contract.messages.scenes import Edit, InsertSource
from fastsplat_contract.messages.things import PickedLevel, Pixel
from tests.query.box_scenes import BoxShell, look, orbit, scene_of
from tests.query.conftest import opened

CUP = BoxShell("mug", (0.12, 0.0, 0.06), (0.12, 0.12, 0.12), count=700)
BOOK = BoxShell("book", (-0.12, 0.0, 0.03), (0.2, 0.14, 0.06), count=400)
FRONT = look((0.0, -0.6, 0.35), (0, 0, 0.04), "front.jpg")
RIM, SPINE = 6, 8


@pytest.fixture
def scene() -> Scene:
    """A mug, thing 3, whose upper half is part 6, and a book, thing 5, with a spine, part 8; nothing has a name."""
    scene = scene_of([CUP, BOOK], orbit())
    count, means = len(scene.gaussians), scene.gaussians.means
    rows = np.arange(count)
    owner = np.repeat([3, 5], [CUP.count, BOOK.count])
    part = np.where((owner == 3) & (means[:, 2] > 0.06), RIM, 0)
    part = np.where((owner == 5) & (means[:, 0] < -0.18), SPINE, part)
    inside = np.flatnonzero(part)
    parts = Parts(
        (Thing(RIM, parent=3, consensus=0.6), Thing(SPINE, parent=5)),
        evidence_of(inside, part[inside], np.full(len(inside), 50 * UNIT), count),
    )
    things = Things((Thing(3), Thing(5)), evidence_of(rows, owner, np.full(count, 50 * UNIT), count), 0, parts)
    return replace(
        scene,
        gaussians=replace(scene.gaussians, codes=np.zeros((count, 0), np.float32)),
        head=type(scene.head)(np.zeros((1, 0), np.float32), np.zeros(1, np.float32)),
        dictionary=type(scene.dictionary)(()),
        label_embeddings=np.zeros((0, 16), np.float32),
        things=things,
    )


def edited(index: SceneIndex, *edits: Edit) -> SceneIndex:
    for edit in edits:
        index = index.after(apply_edit(index, edit, index.things.table))
    return index


def name(thing_id: int, text: str) -> Edit:
    return Edit("name", thing_ids=(thing_id,), name=text)


def test_lists_are_of_things_and_have_the_parts_on_request(scene: Scene) -> None:
    things = opened(scene).things
    assert [(thing.id, thing.kind, thing.parts) for thing in things.listed] == [
        (3, "thing", (RIM,)),
        (5, "thing", (SPINE,)),
    ]
    rows = [(thing.id, thing.kind, thing.parent) for thing in things.listed_with_parts]
    assert rows == [(3, "thing", 0), (RIM, "part", 3), (5, "thing", 0), (SPINE, "part", 5)]
    for part in things.listed_parts:
        owned = np.flatnonzero(things.part_owner == part.id)
        assert part.gaussian_count == len(owned) and (things.owner[owned] == part.parent).all()
        assert part.box is not None and things.get(part.id) == part
        whole = things.get(part.parent).box
        assert whole is not None and min(part.box.size) < min(whole.size)
    assert things.names.searched.unnamed_things == 2  # parts are nothing that a search could have missed


def _ids(levels: tuple[PickedLevel, ...]) -> dict[str, int]:
    return {each.level: each.id for each in levels}


def test_a_click_says_which_part_it_hit(scene: Scene) -> None:
    things = opened(scene).things
    whole, parts = things.map(FRONT), things.part_map(FRONT)
    for thing_id, part_id in ((3, RIM), (5, SPINE)):
        rows, columns = np.nonzero((whole == thing_id) & (parts == part_id))
        pixel = Pixel(columns[0] + 0.5, rows[0] + 0.5)
        assert _ids(pick_pixel(things, FRONT, pixel)) == {"part": part_id, "thing": thing_id}
        rows, columns = np.nonzero((whole == thing_id) & (parts == 0))
        assert _ids(pick_pixel(things, FRONT, Pixel(columns[0] + 0.5, rows[0] + 0.5))) == {"thing": thing_id}
        mean = scene.gaussians.means[things.part_owner == part_id][0]
        assert _ids(pick_point(things, Vector3(*mean.tolist())))["part"] == part_id
    assert 0.2 < (whole[parts > 0] > 0).mean() <= 1 and (parts[whole == 0] == 0).mean() > 0.99


def test_a_named_part_is_asked_for_and_is_its_own_gaussians(scene: Scene) -> None:
    index = edited(opened(scene), name(3, "mug"), name(RIM, "rim"))
    (rim, mug) = index.ask(["rim", "mug"])
    assert (rim.outcome, rim.thing_ids, mug.thing_ids) == ("here", (RIM,), (3,))
    np.testing.assert_array_equal(index.mask3d(rim), index.things.part_owner == RIM)
    np.testing.assert_array_equal(index.mask3d(mug), index.things.owner == 3)
    shown = index.things.part_map(FRONT) == RIM
    assert shown.sum() > 20
    for mask in (index.mask(rim, FRONT), index.mask2d(rim, FRONT).mask):
        np.testing.assert_array_equal(mask, shown)
    (item,) = index.objects_of(rim)
    assert (item.id, item.name, item.gaussian_count) == (RIM, "rim", int((index.things.part_owner == RIM).sum()))
    labels = {entry.label: number for number, entry in enumerate(index.scene.dictionary.entries, start=1)}
    assert index.label_counts[labels["rim"]] == (index.things.part_owner == RIM).sum()
    assert index.label_counts[labels["mug"]] == CUP.count
    both = edited(index, name(SPINE, "mug"))
    (mug,) = both.ask(["mug"])
    assert mug.thing_ids == (3, SPINE)
    np.testing.assert_array_equal(both.mask3d(mug), (both.things.owner == 3) | (both.things.part_owner == SPINE))
    assert (both.mask2d(mug, FRONT).mask == both.mask(mug, FRONT)).all()
    (gone,) = edited(both, Edit("unname", label="mug")).ask(["mug"])
    assert gone.outcome == "cannot_say" and 3 in gone.thing_ids


def test_what_a_person_named_is_guarded_for_parts_too(scene: Scene) -> None:
    before = opened(scene)
    after = edited(before, name(RIM, "rim"))
    with pytest.raises(ConflictError, match="has named thing 6"):
        apply_edit(after, name(RIM, "lip"), before.things.table)
    assert (edited(after, name(RIM, "lip")).things.get(RIM).name, after.things.get(RIM).name) == ("lip", "rim")


def test_edits_of_what_is_seen_take_the_gaussians_of_a_part(scene: Scene) -> None:
    index = opened(scene)
    count, rim = len(scene.gaussians), index.things.part_owner == RIM
    removed = edited(index, Edit("remove", thing_ids=(RIM,)))
    assert count - len(removed.scene.gaussians) >= rim.sum()
    assert [thing.id for thing in removed.things.listed_with_parts] == [3, 5, SPINE]
    with pytest.raises(NotFoundError):
        removed.things.get(RIM)
    red = edited(index, Edit("recolor", thing_ids=(RIM,), color=(1, 0, 0))).scene.gaussians.sh
    changed = (red != scene.gaussians.sh).any(axis=(1, 2))
    assert changed[rim].all() and not changed[index.things.owner == 5].any()


def test_merging_and_discarding_keep_parts_where_their_things_stay(scene: Scene) -> None:
    index = opened(scene)
    merged = edited(index, Edit("merge", thing_ids=(5, 3)))
    assert [(part.id, part.parent) for part in merged.things.listed_parts] == [(RIM, 5), (SPINE, 5)]
    np.testing.assert_array_equal(merged.things.part_owner, index.things.part_owner)
    without = edited(index, Edit("discard", thing_ids=(RIM,)))
    assert [thing.id for thing in without.things.listed_with_parts] == [3, 5, SPINE]
    np.testing.assert_array_equal(without.things.owner, index.things.owner)
    alone = edited(index, Edit("discard", thing_ids=(3, RIM)))
    assert [thing.id for thing in alone.things.listed_with_parts] == [5, SPINE]
    bare = edited(index, Edit("discard", thing_ids=(3, 5)))
    assert bare.scene.things == replace(bare.scene.things, table=(), parts=None)
    with pytest.raises(InvalidInputError, match="a part of thing 3"):
        apply_edit(index, Edit("merge", thing_ids=(5, RIM)))


def test_copies_have_new_ids_and_no_parts(scene: Scene) -> None:
    index = opened(scene)
    aside = np.eye(4)
    aside[0, 3] = 1.0
    copied = edited(index, Edit("duplicate", thing_ids=(3,), transform=pose_of(aside)))
    assert [thing.id for thing in copied.things.listed_with_parts] == [3, RIM, 5, SPINE, SPINE + 1]
    np.testing.assert_array_equal(copied.things.part_owner[len(scene.gaussians) :], 0)
    insert = Edit("insert", thing_ids=(3,), transform=pose_of(aside), source=InsertSource("s"))
    inserted = index.after(apply_edit(index, insert, source=opened(scene)))
    assert [thing.id for thing in inserted.things.listed_with_parts] == [3, RIM, 5, SPINE, SPINE + 1]
    with pytest.raises(InvalidInputError, match="a part of thing 3"):
        apply_edit(index, replace(insert, thing_ids=(RIM,)), source=opened(scene))


def test_what_is_carried_over_an_edit_is_what_a_fresh_look_says(scene: Scene) -> None:
    index = opened(scene)
    index.things.part_map(FRONT)
    steps = (name(RIM, "rim"), name(5, "book"), Edit("discard", thing_ids=(SPINE,)), Edit("merge", thing_ids=(5, 3)))
    for edit in steps:
        index = edited(index, edit)
        fresh = opened(index.scene)
        assert index.things.listed_with_parts == fresh.things.listed_with_parts
        np.testing.assert_array_equal(index.things.part_map(FRONT), fresh.things.part_map(FRONT))


def test_parts_come_back_as_they_were_written(scene: Scene, tmp_path: Path) -> None:
    named = edited(opened(scene), name(RIM, "rim"))
    write_scene(named.scene, tmp_path / "v")
    assert (tmp_path / "v" / "parts.safetensors").is_file()
    again = opened(read_scene(tmp_path / "v"))
    assert again.things.listed_with_parts == named.things.listed_with_parts
    np.testing.assert_array_equal(again.things.part_owner, named.things.part_owner)
    assert again.ask(["rim"])[0].thing_ids == (RIM,)


def test_what_becomes_another_thing_leaves_the_parts_of_its_old_one(scene: Scene) -> None:
    taken = np.flatnonzero(opened(scene).things.part_owner == RIM)[::2]
    changed, new_id = with_new_thing(scene, taken)
    before, after = opened(scene).things, opened(changed).things
    assert new_id == SPINE + 1 and (np.flatnonzero(after.owner == new_id) == taken).all()
    assert not after.part_owner[taken].any()
    others = np.setdiff1d(np.arange(len(scene.gaussians)), taken)
    np.testing.assert_array_equal(after.part_owner[others], before.part_owner[others])
    np.testing.assert_array_equal(after.owner[others], before.owner[others])


def test_a_part_is_not_split(scene: Scene) -> None:
    with pytest.raises(InvalidInputError, match=f"{RIM} is a part of thing 3"):
        split_thing(opened(scene), Edit("split", thing_ids=(RIM,)))
