"""Answers of the sample scene, as trained: none contradicts its own figure, and what is offered is never denied."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import fastsplat
from benchmarks.questions.judging import contradictions
from benchmarks.questions.trained_questions import read_scenes
from fastsplat.service.library.local_scene import LocalScene
from fastsplat.service.settings import load_settings
from fastsplat_contract.messages.queries import Answer, QueryRequest
from tests.query.decisions import alike

_TEXTS = [question.text for scene in read_scenes() if scene.name == "sample" for question in scene.questions]


@pytest.fixture(scope="module", params=["lexicon", "encoder alone"])
def scene(request: pytest.FixtureRequest, models_dir: Path, lexicon_models_dir: Path) -> Iterator[LocalScene]:
    models = lexicon_models_dir if request.param == "lexicon" else models_dir
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("FASTSPLAT_MODELS", str(models))
        load_settings.cache_clear()  # before the fixture that does so for each test
        with fastsplat.open_sample() as opened:
            yield opened


def _ask(scene: LocalScene, *texts: str) -> tuple[Answer, ...]:
    request = QueryRequest(scene.id, texts, outputs=frozenset({"mask3d"}))
    answers = tuple(scene._service.answers.query(request).answers)
    names = {obj.name for obj in scene.objects() if obj.name}
    for answer in answers:
        assert contradictions(answer, names) == [], (answer.text, answer.sentence)
    return answers


def test_no_answer_contradicts_itself(scene: LocalScene) -> None:
    for start in range(0, len(_TEXTS), 32):
        _ask(scene, *_TEXTS[start : start + 32])


def test_a_phrasing_is_answered_as_its_bare_noun(scene: LocalScene) -> None:
    for answer, bare in alike(lambda texts: _ask(scene, *texts)):
        assert answer == bare


def test_what_is_named_or_suggested_is_never_denied(scene: LocalScene) -> None:
    objects = scene.objects()
    names = {obj.name for obj in objects if obj.name}
    suggested = {suggestion.name for obj in objects if not obj.name for suggestion in obj.suggestions}
    for answer in _ask(scene, *sorted(names | suggested)):
        assert answer.outcome in ("here", "probably_here") and answer.object_ids, answer.text


@pytest.mark.parametrize(
    "text", ["the apple nearest to the banana", "the mug left of the vase", "how many objects are on the table?"]
)
def test_what_is_not_decided_is_not_denied(scene: LocalScene, text: str) -> None:
    (answer,) = _ask(scene, text)
    assert not answer.is_absent and (answer.outcome != "cannot_say" or answer.probability is None)


def test_a_surface_without_a_name_is_spoken_of(scene: LocalScene) -> None:
    clock, wall, pictures = _ask(scene, "the clock on the wall", "wall", "what is on the wall?")
    assert clock.phrase is not None and clock.phrase.refusal is None and clock.object_ids == ()
    assert wall.outcome == "here" and wall.object_ids and not wall.relevant_ids
    assert pictures.phrase is not None and not set(pictures.object_ids) & set(wall.object_ids)


def test_what_lies_on_a_table_is_there_whatever_its_shape(scene: LocalScene) -> None:
    on_table, books = _ask(scene, "what is on the table?", "book")
    assert set(books.object_ids) <= {*on_table.object_ids, *on_table.phrase.undecided}


def test_a_color_in_a_name_is_part_of_it(scene: LocalScene) -> None:
    wine, juice, pepper, apple = _ask(scene, "red wine bottle", "orange juice", "black pepper", "the red apple")
    assert [match.label for match in wine.matches if match.relevant] == ["bottle"] and wine.phrase is None
    assert juice.phrase is None
    assert pepper.method != "lexicon" or pepper.phrase is None  # no name of the sample: the lexicon has it
    assert apple.phrase is not None and len(apple.object_ids) == 1


def test_a_color_that_a_quarter_of_an_object_has_is_not_denied(scene: LocalScene) -> None:
    (bottle,) = _ask(scene, "the green bottle")
    assert bottle.outcome in ("cannot_say", "probably_here")
    assert bottle.object_ids == _ask(scene, "bottle")[0].object_ids


def test_the_first_match_is_what_is_shown(scene: LocalScene) -> None:
    for answer in _ask(
        scene, "the largest object", "the tallest object", "something red", "the nearest object to the cup"
    ):
        assert not answer.object_ids or not answer.matches or answer.matches[0].relevant


def test_what_stands_in_for_something_is_not_counted(scene: LocalScene) -> None:
    (forks,) = _ask(scene, "how many forks are there?")
    assert forks.phrase is not None and not forks.phrase.count and not forks.relevant_ids


def test_another_kind_is_found_as_its_last_word_finds_it(scene: LocalScene) -> None:
    bear, black = _ask(scene, "bear", "Where is the black bear?")
    assert black.outcome in ("here", "probably_here") and black.object_ids == bear.object_ids
    assert "bear" in black.sentence


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (("!!!", "the", "what is this?", "the with a", "in the"), ""),
        (("wo ist die Banane?", "le livre", "la silla", "茶壶"), "only English"),
    ],
)
def test_words_that_name_nothing_and_other_languages_find_nothing(
    scene: LocalScene, texts: tuple[str, ...], said: str
) -> None:
    for answer in _ask(scene, *texts):
        assert answer.outcome == "cannot_say" and answer.object_ids == () and answer.probability is None
        assert said in answer.sentence


@pytest.mark.parametrize("text", ["mice", "something for children", "something shiny"])
def test_irregular_plurals_and_words_that_are_no_names_are_english(scene: LocalScene, text: str) -> None:
    (answer,) = _ask(scene, text)
    assert "only English" not in answer.sentence
