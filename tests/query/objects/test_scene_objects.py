"""Objects: the same ids wherever they are asked, and labels that are the set of objects that bear them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.objects.picking import pick_box, pick_pixel, pick_point
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Object, Objects, Scene, SceneFacts
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.scene.artefact.suggestions import Suggestion
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat_contract.errors import (
    ConflictError,
    FastSplatError,
    InvalidInputError,
    LimitExceededError,
    NotFoundError,
)
from fastsplat_contract.geometry.poses import Vector3, pose_of
from fastsplat_contract.messages.objects import PickedLevel, Pixel, PixelBox
from fastsplat_contract.messages.scenes import Edit
from tests.query.box_scenes import BoxShell, look, orbit, scene_of, with_objects
from tests.query.conftest import opened
from tests.query.room import turned

CUP = BoxShell("mug", (0.1, 0.1, 0.04))
TWIN = replace(CUP, centre=(-0.1, 0.15, 0.04))
BOOK = BoxShell("book", (-0.1, 0.0, 0.02), (0.2, 0.14, 0.04), yaw=-0.3, count=400)
FRONT = look((0.1, -0.6, 0.4), (0, 0, 0), "front.jpg")


@pytest.fixture
def labeled() -> Scene:
    """Two mugs and a book by their labels; no objects are stored."""
    return scene_of([CUP, TWIN, BOOK], orbit())


@pytest.fixture
def discovered() -> Scene:
    """The same as three objects that nobody has named: 4, 7 and 9; no labels."""
    owner = np.repeat([4, 7, 9], [CUP.count, TWIN.count, BOOK.count])
    objects = (Object(4), Object(7, suggestions=(Suggestion("kettle", 0.4),)), Object(9, surface="wall"))
    return with_objects(scene_of([CUP, TWIN, BOOK], orbit()), owner, objects)


def edited(index: SceneIndex, *edits: Edit) -> SceneIndex:
    for edit in edits:
        index = SceneIndex(apply_edit(index, edit, index.objects.table), index._encoder, index.settings)
    return index


def name(ids: Any, text: str, *aliases: str) -> Edit:
    return Edit("name", object_ids=tuple(np.atleast_1d(ids).tolist()), name=text, aliases=aliases)


def ids_of(index: SceneIndex) -> dict[int, str]:
    return {obj.id: obj.name for obj in index.objects.listed}


def test_a_scene_without_objects_has_those_of_its_labels_and_always_the_same(labeled: Scene) -> None:
    index = opened(labeled)
    assert list(ids_of(index).values()) == ["mug", "mug", "book"]
    again = opened(labeled)
    np.testing.assert_array_equal(again.objects.owner, index.objects.owner)
    # Every Gaussian of a label that is near an object is the object's: faint ones do not stay behind.
    np.testing.assert_array_equal(index.objects.owner > 0, index.gaussian_classes > 0)
    assert all(obj.source == "detected" and obj.probability == 1 for obj in index.objects.listed)
    given = opened(replace(labeled, facts=SceneFacts(label_source="given")))
    assert {obj.source for obj in given.objects.listed} == {"given"}
    assert index.objects.names.searched.named_objects == 3 and index.ask(["mug"])[0].searched.named_objects is None


def test_ids_stay_over_edits_and_files_and_a_copy_has_a_new_one(labeled: Scene, tmp_path: Path) -> None:
    first = opened(labeled)
    (mug, twin, book) = ids_of(first)
    aside = pose_of(turned(0, z=0.5))
    copied = edited(first, Edit("duplicate", object_ids=(twin,), transform=aside))
    assert ids_of(copied) == {mug: "mug", twin: "mug", book: "book", book + 1: "mug"}
    moved = next(obj for obj in copied.objects.listed if obj.id == book + 1)
    old = next(obj for obj in first.objects.listed if obj.id == twin)
    assert moved.box is not None and old.box is not None
    np.testing.assert_allclose(np.subtract(moved.box.center.position, old.box.center.position), [0, 0, 0.5], atol=1e-5)
    write_scene(copied.scene, tmp_path / "v")
    assert ids_of(opened(read_scene(tmp_path / "v"))) == ids_of(copied)
    removed = edited(copied, Edit("remove", object_ids=(mug,)))
    assert list(ids_of(removed)) == [twin, book, book + 1]
    # No id is given twice, not even that of the last object once it is gone.
    gone = edited(removed, Edit("discard", object_ids=(book + 1,)))
    assert list(ids_of(edited(gone, Edit("duplicate", object_ids=(book,), transform=aside)))) == [twin, book, book + 2]


@pytest.mark.parametrize("kind", ["labeled", "discovered"])
def test_a_label_is_the_union_of_the_objects_that_bear_it(request: pytest.FixtureRequest, kind: str) -> None:
    index = opened(request.getfixturevalue(kind))
    first, second, last = ids_of(index)
    named = edited(index, name([second, last], "Einmachglas", "jar"), name(first, "kettle"))
    (answer, alias, kettle) = named.ask(["einmachglas", "a jar", "kettle"])
    assert answer.outcome == alias.outcome == kettle.outcome == "here"
    assert answer.object_ids == alias.object_ids == (second, last) and kettle.object_ids == (first,)
    owner = named.objects.owner
    np.testing.assert_array_equal(named.mask3d(answer), np.isin(owner, [second, last]))
    np.testing.assert_array_equal(owner, index.objects.owner)
    object_map = named.objects.map(FRONT)
    mask = named.mask2d(answer, FRONT)
    np.testing.assert_array_equal(mask.mask, np.isin(object_map, [second, last]))
    assert mask.mask.any() and (object_map == first).any()
    np.testing.assert_array_equal(named.mask2d(kettle, FRONT).mask, object_map == first)
    assert [obj.id for obj in named.objects_of(answer)] == sorted(
        [second, last], key=lambda object_id: -(owner == object_id).sum()
    )
    assert answer.matches[0].gaussian_count == np.isin(owner, [second, last]).sum()


def test_naming_changes_no_mask_of_what_is_not_named(labeled: Scene) -> None:
    index = opened(labeled)
    before = {text: index.mask2d(index.ask([text])[0], FRONT).mask for text in ("mug", "book")}
    mug = index.objects.listed[0].id
    named = edited(index, name(mug, "kettle"))
    (book, mugs) = named.ask(["book", "mug"])
    assert (named.mask2d(book, FRONT).mask ^ before["book"]).sum() <= 0.02 * before["book"].sum()
    both = named.mask2d(mugs, FRONT).mask | named.mask2d(named.ask(["kettle"])[0], FRONT).mask
    assert (both ^ before["mug"]).sum() <= 0.02 * before["mug"].sum()
    np.testing.assert_array_equal(named.render(FRONT), index.render(FRONT))


def test_a_label_that_nothing_bears_any_more_is_not_known(labeled: Scene) -> None:
    index = edited(opened(labeled), Edit("name", label="mugs", name="kettle"))
    mug, kettle = index.ask(["mug", "kettle"])
    assert (mug.is_absent, mug.object_ids, kettle.outcome, len(kettle.object_ids)) == (True, (), "here", 2)
    assert not index.mask3d(mug).any() and index.mask3d(kettle).sum() == CUP.count + TWIN.count
    back = edited(index, Edit("name", label="kettle", name="Mugs"))
    assert back.ask(["mug"])[0].outcome == "here" and len(back.scene.dictionary) == 3
    np.testing.assert_array_equal(back.mask3d(back.ask(["mug"])[0]), index.mask3d(kettle))


def test_merging_and_discarding_are_what_they_say(discovered: Scene) -> None:
    index = opened(discovered)
    named = edited(index, name(7, "jar"))
    merged = edited(named, Edit("merge", object_ids=(7, 4)))
    assert ids_of(merged) == {7: "jar", 9: ""}
    np.testing.assert_array_equal(merged.objects.owner == 7, np.isin(index.objects.owner, [4, 7]))
    discarded = edited(merged, Edit("discard", object_ids=(7,)))
    assert ids_of(discarded) == {9: ""} and len(discarded.scene.gaussians) == len(index.scene.gaussians)
    assert discarded.ask(["jar"])[0].object_ids == (9,)
    unnamed = edited(named, Edit("unname", label="jar"))
    assert ids_of(unnamed) == {4: "", 7: "", 9: ""} and unnamed.ask(["jar"])[0].outcome != "here"


def test_an_absence_says_what_was_looked_for(discovered: Scene) -> None:
    index = opened(replace(discovered, facts=SceneFacts(searched_names=80, searched_for=("truck",))))
    named = edited(index, name(4, "jar"))
    (answer, kettle) = named.ask(["truck", "kettle"])
    assert "none of the 2 names" in answer.sentence and "2 objects have no name" in answer.sentence
    assert answer.searched == (1, 2, (7, 9), 80)
    assert (kettle.outcome, kettle.object_ids, kettle.relation) == ("probably_here", (7,), "same")
    assert kettle.sentence == 'Perhaps here (40 %): an unnamed object may be "kettle".'
    assert (named.mask3d(kettle) == named.objects.rows((7,))).all()


@pytest.mark.parametrize("phrasing", ["{}", "where is the {}?", "Is there a {} here?"])
def test_absence_is_said_only_where_it_can_be_known(
    discovered: Scene, calibrated_encoder: Any, lexicon: Any, phrasing: str
) -> None:
    """Of words that the models could say, as sure as these are found; of others only without objects that may be it."""
    settings, facts = QuerySettings(backend="cpu"), SceneFacts(searched_for=("person", "spoon", "couch", "cup"))
    index = SceneIndex(replace(discovered, facts=facts), calibrated_encoder, settings, lexicon=lexicon)
    words = ("violinist", "spoon", "sofa", "keyboard", "grand piano", "goose")
    violinist, spoon, sofa, keyboard, piano, goose = index.ask([phrasing.format(word) for word in words])
    assert [answer.outcome for answer in (violinist, spoon, sofa, piano)] == ["not_here"] * 4
    assert 0.5 < (spoon.probability or 0) < (violinist.probability or 0) < 1
    assert (keyboard.outcome, set(keyboard.object_ids), set(goose.object_ids)) == ("cannot_say", {4, 7, 9}, {4, 7})
    assert keyboard.probability is None and not keyboard.relevant_ids and "; 3 objects may be it" in keyboard.sentence
    assert (index.mask3d(keyboard) == index.objects.rows(keyboard.object_ids)).all()
    named = SceneIndex(apply_edit(index, name((4, 7, 9), "jar")), calibrated_encoder, settings, lexicon=lexicon)
    assert [(said.outcome, said.object_ids) for said in named.ask([phrasing.format("keyboard")])] == [("not_here", ())]
    for found, said in ((0.25, ("not_here", pytest.approx(1 / 1.75))), (0.0, ("cannot_say", None))):
        scene = replace(discovered, facts=replace(facts, found_shares={"spoon": found}))
        (spoon,) = SceneIndex(scene, calibrated_encoder, settings, lexicon=lexicon).ask([phrasing.format("spoon")])
        assert (spoon.outcome, spoon.probability) == said


def test_what_looks_alike_is_suggested_and_never_named(discovered: Scene) -> None:
    sh = discovered.gaussians.sh.copy()
    sh[: CUP.count + TWIN.count, 0] = (1.2, -1.2, -1.2)  # both mugs are red
    sh[CUP.count + TWIN.count :, 0] = (-1.2, -1.2, 1.2)
    index = opened(replace(discovered, gaussians=replace(discovered.gaussians, sh=sh)))
    named = edited(index, name(4, "mug"))
    twin, wall = named.objects.listed[1:]
    assert (twin.name, twin.suggestions[0].name) == ("", "mug") and 0.8 < twin.suggestions[0].probability <= 1
    assert wall.suggestions == () and wall.name == ""
    same = replace(discovered, gaussians=replace(discovered.gaussians, sh=np.full_like(sh, 0.3)))
    twin, wall = edited(opened(same), name(4, "mug")).objects.listed[1:]  # of one color all, a book is no mug
    assert [suggestion.name for suggestion in twin.suggestions] == ["mug", "kettle"] and wall.suggestions == ()


def _object(levels: tuple[PickedLevel, ...]) -> int:
    (only,) = levels
    assert (only.level, only.probability) == ("object", 1.0)
    return only.id


def test_picking_finds_what_a_picture_shows(discovered: Scene) -> None:
    objects = opened(discovered).objects
    object_map = objects.map(FRONT)
    for object_id in (4, 7, 9):
        rows, columns = np.nonzero(object_map == object_id)
        assert _object(pick_pixel(objects, FRONT, Pixel(columns[0] + 0.5, rows[0] + 0.999))) == object_id
        box = PixelBox(columns.min(), rows.min(), columns.max() + 1.0, rows.max() + 1.0)
        assert _object(pick_box(objects, FRONT, box)) == object_id
        listed = objects.get(object_id)
        mean = discovered.gaussians.means[objects.owner == object_id][0]
        assert _object(pick_point(objects, Vector3(*mean.tolist()))) == object_id
        assert listed.gaussian_count == (objects.owner == object_id).sum()
    rows, columns = np.nonzero(object_map == 0)
    with pytest.raises(NotFoundError, match="no object"):
        pick_pixel(objects, FRONT, Pixel(columns[0] + 0.5, rows[0] + 0.5))
    for x, y in ((-0.1, 5), (96, 5), (5, 72), (np.nan, 5), (5, -np.inf)):
        with pytest.raises(InvalidInputError, match="pixel"):
            pick_pixel(objects, FRONT, Pixel(x, y))
    for corners in ((5, 5, 5, 9), (-1, 5, 9, 9), (5, 5, 97, 9), (5, 9, 9, 5), (np.nan, 1, 2, 2)):
        with pytest.raises(InvalidInputError, match="box"):
            pick_box(objects, FRONT, PixelBox(*corners))
    with pytest.raises(NotFoundError):
        pick_point(objects, Vector3(5, 5, 5))
    with pytest.raises(InvalidInputError):
        pick_point(objects, Vector3(np.nan, 0, 0))


@pytest.mark.parametrize(
    ("edit", "error", "field"),
    [
        (name(4, ""), InvalidInputError, "name"),
        (Edit("name", object_ids=(4,)), InvalidInputError, "name"),
        (Edit("merge", object_ids=(4, 7), name="jar"), InvalidInputError, "name"),
        (Edit("recolor", object_ids=(4,), color=(1, 0, 0), name="jar"), InvalidInputError, "name"),
        (Edit("merge", object_ids=(4, 4)), InvalidInputError, "object_ids"),
        (Edit("name", label="jar", name="pot"), NotFoundError, "label"),
        (name([4, 5], "jar"), NotFoundError, "object_ids[1]"),
        (name(0, "jar"), NotFoundError, "object_ids[0]"),
        (name(2**40, "jar"), NotFoundError, "object_ids[0]"),
        (name(4, "jar", *(f"alias {i}" for i in range(21))), LimitExceededError, "aliases"),
        (name(4, "jar", ""), InvalidInputError, "aliases[0]"),
        (Edit("discard", object_ids=(8,)), NotFoundError, "object_ids[0]"),
    ],
)
def test_what_makes_no_sense_is_refused(discovered: Scene, edit: Edit, error: type[FastSplatError], field: str) -> None:
    with pytest.raises(error) as raised:
        apply_edit(opened(discovered), edit)
    assert raised.value.field == field


def test_an_alias_that_is_anothers_name_is_refused_and_its_own_is_not(discovered: Scene) -> None:
    index = edited(opened(discovered), name(4, "jar", "pot"))
    with pytest.raises(ConflictError, match="jar"):
        apply_edit(index, name(7, "tub", "pots"))
    again = edited(index, name(7, "Pot", "jars", "can"))
    assert ids_of(again) == {4: "jar", 7: "jar", 9: ""} and again.ask(["can"])[0].object_ids == (4, 7)


@pytest.mark.parametrize("text", ["чайник", "急須", "🫖", "إبريق", "a" * 200, "0", "don't", "Ä Ö"])
def test_names_of_any_script_are_names(discovered: Scene, tmp_path: Path, text: str) -> None:
    write_scene(edited(opened(discovered), name(4, f"  {text} ")).scene, tmp_path / "v")
    index = opened(read_scene(tmp_path / "v"))
    assert ids_of(index)[4] == text
    (answer,) = index.ask([text])
    assert (answer.outcome, answer.object_ids) == ("here", (4,))


def test_a_name_that_a_person_gave_is_replaced_only_by_who_has_seen_it(discovered: Scene) -> None:
    index = opened(discovered)
    looked = index.objects.table
    named = edited(index, name(4, "jar"))
    for edit in (
        name(4, "pot"),
        Edit("unname", object_ids=(4,)),
        Edit("discard", object_ids=(4,)),
        Edit("merge", object_ids=(7, 4)),
    ):
        with pytest.raises(ConflictError, match="'jar'"):
            apply_edit(named, edit)
        with pytest.raises(ConflictError, match="'jar'"):
            apply_edit(named, edit, looked)
        apply_edit(named, edit, named.objects.table)
    assert ids_of(edited(named, name(4, "jar"), name(7, "pot"))) == {4: "jar", 7: "pot", 9: ""}


def test_a_thousand_objects_are_named_at_once() -> None:
    count = 1000
    places = np.stack(np.meshgrid(np.arange(40), np.arange(25)), axis=-1).reshape(-1, 2)
    means = np.repeat(np.concatenate([places, np.zeros((count, 1))], axis=1), 4, axis=0)
    means += np.random.default_rng(0).normal(0, 0.02, means.shape)
    scene = scene_of([replace(CUP, count=4 * count)], orbit())
    scene = replace(scene, gaussians=replace(scene.gaussians, means=means.astype(np.float32)))
    owner = np.repeat(np.arange(1, count + 1), 4)
    membership = evidence_of(np.arange(4 * count), owner, np.full(4 * count, UNIT), 4 * count)
    objects = Objects(tuple(Object(i) for i in range(1, count + 1)), membership)
    index = opened(replace(scene, objects=objects))
    assert len(index.objects.listed) == count
    named = edited(index, name(list(range(1, count)), "post"))
    (answer,) = named.ask(["post"])
    assert answer.object_ids == tuple(range(1, count)) and named.mask3d(answer).sum() == 4 * (count - 1)
