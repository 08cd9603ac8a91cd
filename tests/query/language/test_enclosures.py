"""Laws of what is said of objects that may be kept in something shut: not seen, where it would fit, and only there."""

from __future__ import annotations

from dataclasses import replace

import pytest

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.language.sentences.enclosures import is_kept_shut, width_needed
from fastsplat.service.query.measures.next_viewpoints import next_photos
from fastsplat.service.scene.artefact.scene import SceneFacts
from fastsplat_contract.messages.scenes import Edit
from tests.query.box_scenes import BoxShell, orbit, scene_of
from tests.query.conftest import plain_index_of
from tests.query.cupboard_rooms import with_something_shut, without
from tests.query.walled_room import OBJECTS, SCREEN, WALLS, from_corner

_ROOMS = range(200, 212)


def test_what_would_fit_into_something_shut_is_never_said_to_be_absent() -> None:
    for seed in _ROOMS:
        spoon, piano = plain_index_of(with_something_shut(seed)).ask(["spoon", "piano"])
        assert spoon.outcome == "not_seen" and spoon.probability is None and spoon.is_absent
        assert "looks into" not in piano.sentence  # 0.06 to 1 m³ hold none


def test_where_all_is_seen_or_solid_absence_is_said() -> None:
    for seed in _ROOMS:
        assert plain_index_of(without(seed)).ask(["spoon"])[0].outcome == "not_here"


@pytest.mark.parametrize("stored", [False, True])
def test_the_sentence_says_how_much_and_where_and_next_photos_agree(stored: bool) -> None:
    index = plain_index_of(with_something_shut(0))
    index = plain_index_of(index.objects.scene) if stored else index
    (spoon,) = index.ask(["spoon"])
    (hollow,) = (hollow for hollow in index.objects.unseen.hollows if hollow.volume > 0.1)
    expected = f'; no photo looks into "cupboard" ({hollow.volume:.1g} m³); look into it, from where {hollow.view} was '
    assert expected in spoon.sentence
    (photo,) = (photo for photo in next_photos(index) if photo.reason == "hidden")
    assert photo.near == hollow.view
    assert photo.advice == f"Stand where {hollow.view} was taken, and look into the cupboard, open."


def test_one_is_sent_around_a_screen_to_what_it_hides() -> None:
    index = plain_index_of(scene_of([*WALLS, *OBJECTS, SCREEN], from_corner()))
    photo = next_photos(index)[0]
    assert photo.reason == "hidden" and photo.advice.endswith("and look behind the screen.")
    again = [*from_corner(), replace(photo.camera, name="again.jpg")]
    before, after = (plain_index_of(scene_of([*WALLS, *OBJECTS, SCREEN], views)) for views in (from_corner(), again))
    assert after.objects.unseen.share < before.objects.unseen.share
    there = plain_index_of(scene_of([*WALLS, *OBJECTS], from_corner()))
    assert "hidden" not in {photo.reason for photo in next_photos(there)}


def test_a_name_decides_whether_an_object_may_be_hollow() -> None:
    index = plain_index_of(plain_index_of(with_something_shut(0)).objects.scene)
    (cupboard,) = index.ask(["cupboard"])[0].object_ids
    named = index.after(apply_edit(index, Edit("name", object_ids=(cupboard,), name="tree stump")))
    assert named.ask(["spoon"])[0].outcome == "not_here"
    objects = index.objects.scene.objects
    assert objects is not None
    bare = replace(objects.table[cupboard - 1], name="", source=None, probability=0.0)
    assert bare.id == cupboard
    table = tuple(bare if obj.id == cupboard else obj for obj in objects.table)
    scene = replace(
        index.objects.scene, objects=replace(objects, table=table), facts=SceneFacts(searched_for=("spoon",))
    )
    (spoon,) = plain_index_of(scene).ask(["spoon"])
    assert spoon.outcome == "not_seen" and "looks into an unnamed object (" in spoon.sentence


def test_a_closed_carton_on_a_table_may_hold_what_is_smaller() -> None:
    table = BoxShell("table", (0, 0, -0.02), (2.4, 1.6, 0.04), count=3000)
    carton = BoxShell("carton", (0.7, 0.4, 0.2), (0.4, 0.4, 0.4), count=1200)
    index = plain_index_of(scene_of([table, *OBJECTS, carton], orbit(16, 1.6, 1.0)))
    spoon, piano = index.ask(["spoon", "piano"])
    assert (spoon.outcome, piano.outcome) == ("not_seen", "not_here")
    assert not index.objects.unseen.hides


def test_what_asks_for_a_place_is_not_answered_by_another_one() -> None:
    """A mug is here, and not on the book: what may be in the cupboard would not be on the book either."""
    (answer,) = plain_index_of(with_something_shut(0)).ask(["the mug on the book"])
    assert answer.outcome == "not_here"


def test_kinds_and_sizes() -> None:
    assert all(map(is_kept_shut, ("kitchen cabinet", "white cupboard", "Refrigerators", "suitcase", "")))
    assert not any(map(is_kept_shut, ("apple", "book", "sofa", "teddy bear", "table", "no such word")))
    assert width_needed("sofa") == width_needed("red car") > width_needed("mug") == width_needed("no such word")
