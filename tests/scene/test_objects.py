"""Objects: written with the scene and read back, named without touching anything else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.application.base.validate import check_request, check_scene_name
from fastsplat.service.capture.uploads.label_maps import parse_label_table
from fastsplat.service.scene.artefact.reads import MAX_READ_CHARS, MOST_READS, bounded_reads, one_line
from fastsplat.service.scene.artefact.scene import Looks, Object, ObjectGroup, Objects, Scene, SemanticHead
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.scene.artefact.suggestions import Suggestion
from fastsplat.service.scene.objects.label_evidence import evidence_of
from fastsplat.service.scene.objects.objects import (
    MAX_NAME_CHARS,
    checked_name,
    discard_object,
    merge_objects,
    next_object_id,
    object_count,
    object_of,
    object_rows,
    objects_of_rows,
)
from fastsplat.service.settings import StoreOptions
from fastsplat_contract.codec.unseen_characters import unseen_in
from fastsplat_contract.errors import FastSplatError, InvalidInputError, Kind, NotFoundError, SceneFileError
from fastsplat_contract.jobs.operations import SceneOptions
from fastsplat_contract.messages.object_reads import ObjectRead
from tests.scene.conftest import change_body, make_scene, read_back

IDS = (2, 5, 9)


def _objects(count: int) -> Objects:
    """Gaussian g belongs to the object g mod 4 of none and `IDS`, 60 % sure; every third says a little of another."""
    rows = np.arange(count)
    owner = np.array([0, *IDS])[rows % 4]
    every_third = np.arange(0, count, 3)
    membership = evidence_of(
        np.concatenate([rows, every_third]),
        np.concatenate([owner, np.full(len(every_third), IDS[1])]),
        np.concatenate([np.full(count, 600), np.full(len(every_third), 90)]),
        count,
    )
    table = (
        Object(2, "Tasse ☕", "person", 1.0, 0.9, appearance=bytes(range(250)), picture=b"\xff\xd8"),
        Object(
            5,
            consensus=0.7,
            surface="wall",
            suggestions=(Suggestion("bottle", 0.4), Suggestion("vase", 0.3, "eyes", "v1", ("urn",))),
            proposed_in=(0, 3),
            missed_in=(1,),
        ),
        Object(
            9,
            "mug",
            "detected",
            0.8,
            0.6,
            reads=(ObjectRead("text", "Tee für zwei", 0.9, 3),),
            looks=Looks("ab" * 32, b"\x01\x3c"),
        ),
    )
    return Objects(table, membership, groups=(ObjectGroup(11, (2, 9), 0.5), ObjectGroup(12, IDS, 0.4)))


@pytest.fixture
def scene() -> Scene:
    return replace(make_scene(count=80), objects=_objects(80))


def test_objects_come_back_as_they_were_written(scene: Scene, tmp_path: Path) -> None:
    head = SemanticHead(np.full((4, 3), 0.5, np.float32), np.arange(4, dtype=np.float32))
    read = read_back(replace(scene, objects=replace(scene.objects, head=head)), tmp_path / "v1").objects
    assert read.table == scene.objects.table and read.groups == scene.objects.groups
    for name in ("starts", "labels", "counts"):
        assert (getattr(read.membership, name) == getattr(scene.objects.membership, name)).all()
    assert (read.head.weight == head.weight).all() and (read.head.bias == head.bias).all()
    assert read_back(scene, tmp_path / "counted").objects.head is None


def test_a_scene_without_objects_has_no_file_of_them(tmp_path: Path) -> None:
    assert read_back(make_scene(), tmp_path / "v1").objects is None
    assert not (tmp_path / "v1" / "objects.safetensors").exists()


def test_neither_surfaces_nor_objects_without_gaussians_count(scene: Scene) -> None:
    objects = scene.objects
    of_surface = {obj.id: bool(obj.surface) for obj in objects.table}
    assert of_surface == {2: False, 5: True, 9: False} and object_count(objects) == 2
    without_9 = objects_of_rows(objects, np.flatnonzero(object_rows(objects) != 9))
    assert without_9 is not None and len(without_9.table) == 3 and object_count(without_9) == 1


def test_groups_follow_their_objects(scene: Scene) -> None:
    def groups(after: Scene) -> list[tuple[int, tuple[int, ...]]]:
        return [(group.id, group.members) for group in after.objects.groups]

    assert groups(merge_objects(scene, (5, 2))) == [(11, (5, 9))]  # both groups have these members now
    assert groups(merge_objects(scene, (2, 9))) == [(12, (2, 5))]
    assert groups(merge_objects(scene, (2, 9, 5))) == []
    assert groups(discard_object(scene, 5)) == [(11, (2, 9))]
    assert groups(discard_object(scene, 2)) == [(12, (5, 9))]
    assert groups(discard_object(discard_object(scene, 2), 9)) == []
    bare = discard_object(discard_object(scene, 2), 9)
    assert bare.objects is not None and next_object_id(bare.objects) == 13  # no id is used again


def test_a_table_that_lacks_an_object_is_refused_on_both_ways(scene: Scene, tmp_path: Path) -> None:
    torn = replace(scene, objects=replace(scene.objects, table=scene.objects.table[:2], groups=()))
    with pytest.raises(InvalidInputError, match="object 9"):
        write_scene(torn, tmp_path / "torn")
    write_scene(scene, tmp_path / "v1")
    change_body(tmp_path / "v1", lambda body: (body["objects"]["table"].pop(), body["objects"]["groups"].clear()))
    with pytest.raises(SceneFileError, match="object 9"):
        read_scene(tmp_path / "v1")


@pytest.mark.parametrize(
    ("rows", "change"),
    [
        *(
            ("groups", change)
            for change in ({"id": 9}, {"id": 12}, {"members": [2]}, {"members": [9, 2]}, {"members": [2, 4]})
        ),
        ("groups", {"consensus": 2.0}),
        *(
            ("table", change)
            for change in ({"id": 0}, {"id": 5}, {"probability": 2.0}, {"source": None}, {"surface": "roof"})
        ),
        ("table", {"name": 7}),
    ],
)
def test_a_damaged_row_says_so(scene: Scene, tmp_path: Path, rows: str, change: dict[str, object]) -> None:
    write_scene(scene, tmp_path / "v1")
    change_body(tmp_path / "v1", lambda body: body["objects"][rows][0].update(change))
    with pytest.raises(SceneFileError, match="malformed"):
        read_scene(tmp_path / "v1")


def test_a_changed_membership_says_so(scene: Scene, tmp_path: Path) -> None:
    write_scene(scene, tmp_path / "v1")
    path = tmp_path / "v1" / "objects.safetensors"
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)
    with pytest.raises(SceneFileError, match="objects"):
        read_scene(tmp_path / "v1")


_UNSEEN = ["two\nlines", "two\u2028lines", "bell\x07", "\ud800", "\u202egnp.exe", "a\u200bb", "a\u200db", "\ufeffmug"]
_UNSEEN += ["soft\u00adhyphen", "a\u200c", "\u200da", "mug\u3164", "\U000e0041mug", "م\u200dم"]


@pytest.mark.parametrize("name", ["x" * (MAX_NAME_CHARS + 1), "...", "\u200b", *_UNSEEN])
def test_names_that_are_none_are_refused_wherever_they_come_from(name: str) -> None:
    for check in (
        lambda: checked_name(name, "name"),
        lambda: check_request("", "", SceneOptions(labels=(name,)), StoreOptions()),
        lambda: check_scene_name(name),
        lambda: parse_label_table({name: 1}, field="labels"),
    )[: None if name in _UNSEEN else 1]:
        with pytest.raises(FastSplatError) as raised:
            check()
        assert raised.value.kind is Kind.INVALID_ARGUMENT and raised.value.field.partition("[")[0] in ("name", "labels")


@pytest.mark.parametrize(
    "name", ["می\u200cخواهم", "क\u094d\u200dष", "👩🏽\u200d🍳", "🏳\ufe0f\u200d🌈", "3½ cups", "花瓶"]
)
def test_names_of_every_script_pass(name: str) -> None:
    assert checked_name(name, "name") == name and unseen_in(name) == ""


def test_merged_objects_have_all_gaussians_of_both_and_the_first_one_name(scene: Scene) -> None:
    before = object_rows(scene.objects)
    merged = merge_objects(scene, [9, 2]).objects
    assert (object_rows(merged) == np.where(before == 2, 9, before)).all()
    assert [obj.id for obj in merged.table] == [5, 9] and object_of(merged, 9).name == "mug"
    assert merged.membership.counts.sum() == scene.objects.membership.counts.sum()
    other_way = merge_objects(scene, [2, 9]).objects
    assert object_of(other_way, 2).reads == object_of(scene.objects, 9).reads != ()
    with pytest.raises(InvalidInputError):
        merge_objects(scene, [9, 9])
    with pytest.raises(NotFoundError):
        merge_objects(scene, [9, 3])


@given(st.lists(st.tuples(st.text(max_size=240), st.floats(0, 1)), max_size=40))
def test_reads_are_bounded_lines_each_once_and_the_likeliest_first(said: list[tuple[str, float]]) -> None:
    reads = bounded_reads(ObjectRead("text", text, probability, 1) for text, probability in said)
    likely = [read.probability for read in reads]
    assert likely == sorted(likely, reverse=True) and len(reads) == len({read.text for read in reads}) <= MOST_READS
    assert all(read.text == one_line(read.text) != "" and len(read.text) <= MAX_READ_CHARS for read in reads)
    assert bounded_reads(reads) == reads


def test_a_line_has_no_character_that_is_not_seen() -> None:
    assert one_line(" oat\n\tmilk\x1b[2J\u202e\u200b ") == "oat milk[2J"


def test_a_discarded_object_leaves_its_gaussians_to_nobody(scene: Scene) -> None:
    before = object_rows(scene.objects)
    without = discard_object(scene, 2).objects
    assert (object_rows(without) == np.where(before == 2, 0, before)).all()
    assert [obj.id for obj in without.table] == [5, 9]


def test_objects_follow_the_rows(scene: Scene) -> None:
    rows = np.array([7, 3, 3, 50])
    taken = objects_of_rows(scene.objects, rows)
    assert taken is not None and taken.table == scene.objects.table
    assert (object_rows(taken) == object_rows(scene.objects)[rows]).all()
    assert objects_of_rows(None, rows) is None
