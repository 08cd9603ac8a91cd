"""What is written on objects is asked for: in so many words, of a kind of object, and by a name that nothing bears."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest

from fastsplat.service.query.phrases.written_words import WrittenWords, asked_of_writing
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Object, Scene
from fastsplat_contract.messages.object_reads import ObjectRead, ReadKind
from tests.query.box_scenes import rigid
from tests.query.conftest import index_of
from tests.query.phrases.test_looks_answers import _answer
from tests.query.placed_rooms import Room, box, scene_of

_WORLD = rigid(3)
_TABLE, _RED_BOOK, _OTHER_RED_BOOK, _BLUE_BOOK, _BOX = range(1, 6)


def _read(text: str, probability: float = 0.9, kind: ReadKind = "text") -> ObjectRead:
    return ObjectRead(kind, text, probability, 3)


_READS: Mapping[int, tuple[ObjectRead, ...]] = {
    _RED_BOOK: (_read("To the"), _read("Lighthouse", 0.8), _read("Virginia Woolf")),
    _BLUE_BOOK: (_read("ORLANDO"), _read("V. WOOLF", 0.4)),
    _BOX: (_read("Oat Milk 1.5 l"), _read("12", 1.0, "tag"), _read("Hafermilch")),
}


@pytest.fixture(scope="module")
def scene() -> Scene:
    red, blue = (0.75, 0.1, 0.1), (0.12, 0.25, 0.75)
    room = Room.table_with(("book", red), ("book", red), ("book", blue))
    room.place("crate", box((0.15, 0.15, 0.2)), (0.0, 0.25, 0.75), 0.2, (0.95, 0.95, 0.93))
    scene = scene_of(room, 0, _WORLD)
    assert scene.objects is not None
    table_ = tuple(replace(obj, reads=_READS.get(obj.id, ())) for obj in scene.objects.table)
    return replace(scene, objects=replace(scene.objects, table=table_))


@pytest.fixture(scope="module")
def index(scene: Scene) -> SceneIndex:
    return index_of(scene)


@pytest.mark.parametrize(
    ("text", "objects"),
    [
        ("where does it say oat milk?", {_BOX}),
        ('Where does it say "Oat Milk"?', {_BOX}),
        ("where is lighthouse written?", {_RED_BOOK}),
        ("what says Hafermilch", {_BOX}),
        ("the red book by Woolf", {_RED_BOOK}),
        ("the book by Virginia Woolf", {_RED_BOOK}),
        ("books by Woolf", {_RED_BOOK, _BLUE_BOOK}),
        ("books not by Woolf", {_OTHER_RED_BOOK}),
        ("the blue book titled Orlando", {_BLUE_BOOK}),
        ("the book that says to the lighthouse on the table", {_RED_BOOK}),
        ("where does it say lighthause", {_RED_BOOK}),
        ("how many books are by Woolf?", {_RED_BOOK, _BLUE_BOOK}),
    ],
)
def test_objects_are_found_by_what_is_written_on_them(index: SceneIndex, text: str, objects: set[int]) -> None:
    answer = _answer(index, text)
    assert set(answer.object_ids) == objects, answer.sentence
    assert answer.outcome in ("here", "probably_here") and set(index.ranked.names.picks(answer) or ()) == objects


@pytest.mark.parametrize("text", ["oat milk", "Hafermilch", "tag 12", "where is the oat milk?", "To the Lighthouse"])
def test_what_nothing_is_named_may_be_where_it_is_written(index: SceneIndex, text: str) -> None:
    answer = _answer(index, text)
    assert (answer.outcome, len(answer.object_ids)) == ("probably_here", 1) and "says" in answer.sentence
    assert answer.probability is None  # nobody measured how often what says "oat milk" is oat milk


def test_how_probable_what_is_written_is_counts(index: SceneIndex) -> None:
    assert _answer(index, "where does it say woolf").probability == pytest.approx(0.4)
    assert _answer(index, "the red book by Woolf").probability == pytest.approx(0.9)
    assert _answer(index, "where does it say lighthause").probability == pytest.approx(0.8 * 0.9)


@pytest.mark.parametrize("text", ["where does it say almond milk", "the crate that says Woolf", "where does it say 13"])
def test_what_no_photo_shows_is_not_said_to_be_absent(index: SceneIndex, text: str) -> None:
    answer = _answer(index, text)
    assert answer.outcome == "cannot_say" and answer.phrase is not None and answer.phrase.refusal is not None
    assert answer.phrase.refusal.reason == "not_read"


def test_names_come_before_what_is_written_and_by_is_a_place_where_nothing_says_so(index: SceneIndex) -> None:
    assert set(_answer(index, "book").object_ids) == {_RED_BOOK, _OTHER_RED_BOOK, _BLUE_BOOK}
    by_place = _answer(index, "the book by the crate").phrase
    assert by_place is not None and by_place.refusal is not None and by_place.refusal.reason == "not_understood"


def test_a_scene_without_reads_answers_as_if_there_were_none(scene: Scene) -> None:
    assert scene.objects is not None
    silent = replace(scene.objects, table=tuple(replace(obj, reads=()) for obj in scene.objects.table))
    index = index_of(replace(scene, objects=silent))
    assert not _answer(index, "Hafermilch").object_ids and not _answer(index, "oat milk").object_ids
    assert _answer(index, "where does it say Hafermilch").outcome == "cannot_say"


def test_figures_are_the_same_or_not_it_and_one_letter_of_five_may_differ() -> None:
    written = WrittenWords((Object(1, reads=(_read("Basmati 500 g", 1.0),)),))
    assert written.bearing("basmati") == written.bearing("500") == written.bearing("500 g Basmati") == {1: 1.0}
    assert written.bearing("basnati")[1] == pytest.approx(6 / 7)
    assert not written.bearing("501") and not written.bearing("bas") and not written.bearing("bazznati")
    assert not written.bearing("") and not written.bearing("basmati rice")
    assert written.leading(["Basmati", "500", "on", "the", "table"]) == 2 and written.leading(["rice"]) == 0


def test_questions_for_what_is_written_are_noun_phrases_of_something() -> None:
    assert asked_of_writing("Where does it say exit?") == "something that says exit?"
    assert asked_of_writing("where is EXIT written?") == "something that says EXIT"
    assert asked_of_writing("where is the mug?") == "where is the mug?"
