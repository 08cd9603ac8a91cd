"""Things: written with the scene and read back, named without touching anything else."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.application.base.validate import check_request, check_scene_name
from fastsplat.service.capture.uploads.label_maps import parse_label_table
from fastsplat.service.scene.artefact.reads import MAX_READ_CHARS, MOST_READS, bounded_reads, one_line
from fastsplat.service.scene.artefact.scene import Looks, Scene, Thing, ThingGroup, Things
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.scene.artefact.suggestions import Suggestion
from fastsplat.service.scene.objects.label_evidence import evidence_of
from fastsplat.service.scene.objects.things import (
    MAX_NAME_CHARS,
    checked_name,
    discard_thing,
    merge_things,
    next_thing_id,
    thing_count,
    thing_of,
    thing_rows,
    things_of_rows,
)
from fastsplat.service.settings import StoreOptions
from fastsplat_contract.codec.unseen_characters import unseen_in
from fastsplat_contract.errors import FastSplatError, InvalidInputError, Kind, NotFoundError, SceneFileError
from fastsplat_contract.jobs.operations import SceneOptions
from fastsplat_contract.messages.thing_reads import ThingRead
from tests.scene.conftest import make_scene, sealed

IDS = (2, 5, 9)


def _things(count: int) -> Things:
    """Gaussian g belongs to the thing g mod 4 of none and `IDS`, 60 % sure; every third says a little of another."""
    rows = np.arange(count)
    owner = np.array([0, *IDS])[rows % 4]
    other = np.arange(0, count, 3)
    membership = evidence_of(
        np.concatenate([rows, other]),
        np.concatenate([owner, np.full(len(other), IDS[1])]),
        np.concatenate([np.full(count, 600), np.full(len(other), 90)]),
        count,
    )
    table = (
        Thing(2, "Tasse ☕", "person", 1.0, 0.9, appearance=bytes(range(250)), picture=b"\xff\xd8"),
        Thing(
            5,
            consensus=0.7,
            surface="wall",
            suggestions=(Suggestion("bottle", 0.4), Suggestion("vase", 0.3, "eyes", "v1", ("urn",))),
            proposed_in=(0, 3),
            missed_in=(1,),
        ),
        Thing(
            9,
            "mug",
            "detected",
            0.8,
            0.6,
            reads=(ThingRead("text", "Tee für zwei", 0.9, 3),),
            looks=Looks("ab" * 32, b"\x01\x3c"),
        ),
    )
    return Things(table, membership, groups=(ThingGroup(11, (2, 9), 0.5), ThingGroup(12, IDS, 0.4)))


@pytest.fixture
def scene() -> Scene:
    return replace(make_scene(count=80), things=_things(80))


def test_things_come_back_as_they_were_written(scene: Scene, tmp_path: Path) -> None:
    write_scene(scene, tmp_path / "v1")
    read = read_scene(tmp_path / "v1").things
    assert scene.things is not None and read is not None
    assert read.table == scene.things.table and read.groups == scene.things.groups
    for name in ("starts", "labels", "counts"):
        assert (getattr(read.membership, name) == getattr(scene.things.membership, name)).all()


def test_a_scene_without_things_has_no_file_of_them(tmp_path: Path) -> None:
    write_scene(make_scene(), tmp_path / "v1")
    assert read_scene(tmp_path / "v1").things is None
    assert not (tmp_path / "v1" / "things.safetensors").exists()


def test_neither_surfaces_nor_things_without_gaussians_count(scene: Scene) -> None:
    things = scene.things
    assert things is not None
    of_surface = {thing.id: bool(thing.surface) for thing in things.table}
    assert of_surface == {2: False, 5: True, 9: False} and thing_count(things) == 2
    without_9 = things_of_rows(things, np.flatnonzero(thing_rows(things) != 9))
    assert without_9 is not None and len(without_9.table) == 3 and thing_count(without_9) == 1


def test_groups_follow_their_things(scene: Scene) -> None:
    def groups(after: Scene) -> list[tuple[int, tuple[int, ...]]]:
        assert after.things is not None
        return [(group.id, group.members) for group in after.things.groups]

    assert groups(merge_things(scene, (5, 2))) == [(11, (5, 9))]  # both groups have these members now
    assert groups(merge_things(scene, (2, 9))) == [(12, (2, 5))]
    assert groups(merge_things(scene, (2, 9, 5))) == []
    assert groups(discard_thing(scene, 5)) == [(11, (2, 9))]
    assert groups(discard_thing(scene, 2)) == [(12, (5, 9))]
    assert groups(discard_thing(discard_thing(scene, 2), 9)) == []
    bare = discard_thing(discard_thing(scene, 2), 9)
    assert bare.things is not None and next_thing_id(bare.things) == 13  # no id is used again


def test_a_table_that_lacks_a_thing_is_refused_on_both_ways(scene: Scene, tmp_path: Path) -> None:
    assert scene.things is not None
    torn = replace(scene, things=replace(scene.things, table=scene.things.table[:2], groups=()))
    with pytest.raises(InvalidInputError, match="thing 9"):
        write_scene(torn, tmp_path / "torn")
    write_scene(scene, tmp_path / "v1")
    path = tmp_path / "v1" / "scene.json"
    body = json.loads(path.read_text())
    body["things"]["table"].pop()
    body["things"]["groups"].clear()
    path.write_text(sealed(body))
    with pytest.raises(SceneFileError, match="thing 9"):
        read_scene(tmp_path / "v1")


@pytest.mark.parametrize(
    ("rows", "change"),
    [
        *(
            ("groups", one)
            for one in ({"id": 9}, {"id": 12}, {"members": [2]}, {"members": [9, 2]}, {"members": [2, 4]})
        ),
        ("groups", {"consensus": 2.0}),
        *(
            ("table", one)
            for one in ({"id": 0}, {"id": 5}, {"probability": 2.0}, {"source": None}, {"surface": "roof"})
        ),
        ("table", {"name": 7}),
    ],
)
def test_a_damaged_row_says_so(scene: Scene, tmp_path: Path, rows: str, change: dict[str, object]) -> None:
    write_scene(scene, tmp_path / "v1")
    path = tmp_path / "v1" / "scene.json"
    body = json.loads(path.read_text())
    body["things"][rows][0] |= change
    path.write_text(sealed(body))
    with pytest.raises(SceneFileError, match="malformed"):
        read_scene(tmp_path / "v1")


def test_a_changed_membership_says_so(scene: Scene, tmp_path: Path) -> None:
    write_scene(scene, tmp_path / "v1")
    path = tmp_path / "v1" / "things.safetensors"
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)
    with pytest.raises(SceneFileError, match="things"):
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


def test_merged_things_have_all_gaussians_of_both_and_the_first_one_name(scene: Scene) -> None:
    assert scene.things is not None
    before = thing_rows(scene.things)
    merged = merge_things(scene, [9, 2]).things
    assert merged is not None
    assert (thing_rows(merged) == np.where(before == 2, 9, before)).all()
    assert [thing.id for thing in merged.table] == [5, 9] and thing_of(merged, 9).name == "mug"
    assert merged.membership.counts.sum() == scene.things.membership.counts.sum()
    other_way = merge_things(scene, [2, 9]).things
    assert other_way is not None
    assert thing_of(other_way, 2).reads == thing_of(scene.things, 9).reads != ()
    with pytest.raises(InvalidInputError):
        merge_things(scene, [9, 9])
    with pytest.raises(NotFoundError):
        merge_things(scene, [9, 3])


@given(st.lists(st.tuples(st.text(max_size=240), st.floats(0, 1)), max_size=40))
def test_reads_are_bounded_lines_each_once_and_the_likeliest_first(said: list[tuple[str, float]]) -> None:
    kept = bounded_reads(ThingRead("text", text, probability, 1) for text, probability in said)
    likely = [read.probability for read in kept]
    assert likely == sorted(likely, reverse=True) and len(kept) == len({read.text for read in kept}) <= MOST_READS
    assert all(read.text == one_line(read.text) != "" and len(read.text) <= MAX_READ_CHARS for read in kept)
    assert bounded_reads(kept) == kept


def test_a_line_has_no_character_that_is_not_seen() -> None:
    assert one_line(" oat\n\tmilk\x1b[2J\u202e\u200b ") == "oat milk[2J"


def test_a_discarded_thing_leaves_its_gaussians_to_nobody(scene: Scene) -> None:
    assert scene.things is not None
    before = thing_rows(scene.things)
    without = discard_thing(scene, 2).things
    assert without is not None
    assert (thing_rows(without) == np.where(before == 2, 0, before)).all()
    assert [thing.id for thing in without.table] == [5, 9]


def test_things_follow_the_rows(scene: Scene) -> None:
    assert scene.things is not None
    rows = np.array([7, 3, 3, 50])
    taken = things_of_rows(scene.things, rows)
    assert taken is not None and taken.table == scene.things.table
    assert (thing_rows(taken) == thing_rows(scene.things)[rows]).all()
    assert things_of_rows(None, rows) is None
