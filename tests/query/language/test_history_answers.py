"""What a scene's history says of objects that are there, have moved, are missing, or were found again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.query.language.sentences.history_answers import _MOST_TOLD, HistoryAnswers
from fastsplat.service.query.language.sentences.time_questions import time_question
from fastsplat.service.query.objects.names.object_names import ObjectNames
from fastsplat.service.query.objects.object_history import scene_history
from fastsplat.service.scene.artefact.scene import Object, SceneFacts
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.messages.queries import Answer
from fastsplat_contract.photos.localization import ChangeKind, SceneChange
from fastsplat_contract.photos.observations import Observation
from tests.scenes import labelled_scene

_MUG, _LAMP = 1, 2
_SCENE_TIME = datetime(2026, 11, 20, 9, tzinfo=UTC)
_NOW = datetime(2026, 11, 26, 9, tzinfo=UTC)
_THERE = Box(Pose(Vector3(1.0, 2.0, 0.5), Quaternion(0.0, 0.0, 0.0, 1.0)), Vector3(0.1, 0.1, 0.1))
_Days = Sequence[tuple[int, ChangeKind | None]]


def _observation(day: int, kind: ChangeKind | None) -> Observation:
    """The mug and the lamp were looked at on a day of November; what had become of the mug."""
    at = datetime(2026, 11, day, 18, tzinfo=UTC)
    after = _THERE if kind in ("moved", "changed") else None
    changes = () if kind is None else (SceneChange(kind, _MUG, "mug", 0.9, 0.4, _THERE, after, (0, 1), ""),)
    return Observation("s", f"e{day}", at, "given", (), (), changes, (_MUG, _LAMP), True, "")


def _answers(days: _Days, **observed: Any) -> HistoryAnswers:
    """Of a scene of 20 November, and of later days, in any order, with these fields of their observations."""
    scene = labelled_scene(
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
        [1, 2],
        ("mug", "lamp"),
        facts=SceneFacts(taken_at={"a.jpg": _SCENE_TIME.timestamp()}),
        observations=tuple(replace(_observation(*day), **observed) for day in reversed(days)),
    )
    objects = tuple(Object(number, name, "person", 1.0) for number, name in ((_MUG, "mug"), (_LAMP, "lamp")))
    names = ObjectNames(dictionary_of(("mug", "lamp")), objects, (), None)
    return HistoryAnswers(scene_history(scene), names, lambda ids: f'"{names.called[ids[0]]}"', "m")


def _found(obj: int = _MUG) -> Answer:
    return Answer("s", "mug", 0.97, (1,), 0.9, "1", 2, 0, (), (), object_ids=(obj,), outcome="here", sentence="Here.")


def _answer_on(days: _Days, text: str, **observed: Any) -> Answer:
    question = time_question(text, _NOW)
    assert question is not None
    return _answers(days, **observed).answer_to(question, _found())


@pytest.mark.parametrize(
    ("days", "outcome", "sentence"),
    [
        ([], "here", "Here."),
        ([(23, None)], "here", "Here."),
        (
            [(23, "moved")],
            "here",
            'Here. By photos of 23 November 2026: The "mug" has moved by 0.40 m, to (1.00, 2.00, 0.50) m.',
        ),
        (
            [(23, "gone"), (24, "changed")],
            "not_here",
            'Not here any more: "mug"; its place is that where it was. The "mug" is missing since 23 November 2026, '
            "and was last seen on 20 November 2026.",
        ),
        ([(23, "gone"), (24, None)], "here", "Here."),
    ],
)
def test_a_plain_question_hears_of_it(days: _Days, outcome: str, sentence: str) -> None:
    answer = _answers(days).plain(_found())
    assert (answer.outcome, answer.sentence) == (outcome, sentence)
    assert _answers(days).plain(_found(_LAMP)) == _found(_LAMP)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("where was the mug on 21 November?", 'The "mug" was where the scene shows it, by photos of 20 November 2026'),
        ("where was the mug on 19 November?", "No photo is of 19 November 2026 or before"),
        ("where was the mug on Monday?", 'By photos of 23 November 2026: The "mug" has moved by 0.40 m, to (1.00'),
        (
            "where was the mug yesterday?",
            "By photos of 24 November 2026, nobody having looked on 25 November 2026: The",
        ),
        (
            "when was the mug last seen?",
            'The "mug" is missing since 24 November 2026, and was last seen on 23 November',
        ),
        ("what is gone?", 'By photos of 23 November 2026 and 24 November 2026: The "mug" is not where it was.'),
        ("what is gone since Monday?", 'By photos of 23 November 2026 and 24 November 2026: The "mug" is not where'),
        ("what moved?", "Nothing has moved: photos of 23 November 2026 and 24 November 2026 looked at 2 objects."),
        (
            "what moved since yesterday?",
            "Cannot say: no photos of another day are kept with this scene since 25 November",
        ),
    ],
)
def test_a_question_of_time_is_answered_by_the_photos_of_the_day(text: str, sentence: str) -> None:
    assert _answer_on([(23, "moved"), (24, "gone")], text).sentence.startswith(sentence)


def test_what_is_as_it_was_before_the_day_has_not_become_so_since() -> None:
    days: _Days = [(22, "gone"), (25, "gone")]
    assert _answer_on(days, "what is gone?").object_ids == (_MUG,)
    since = _answer_on(days, "what is gone since Monday?")
    assert (since.object_ids, since.outcome) == ((), "not_here")


def test_when_it_is_missing_and_when_it_was_seen() -> None:
    history = _answers([(22, "gone"), (23, None), (24, "gone"), (25, "changed")])._history
    day = datetime(2026, 11, 1, 18, tzinfo=UTC)
    assert history.last_seen(_MUG) == day + timedelta(22) and history.missing_since(_MUG) == day + timedelta(23)
    assert history.seen_in(_MUG) == "e25" and history.missing_since(_LAMP) is None
    assert history.last_seen(3) == _SCENE_TIME and history.seen_in(3) == ""


def test_photos_of_before_the_capture_say_nothing_of_after_it() -> None:
    days: _Days = [(18, "gone")]
    assert _answers(days).plain(_found()) == _found()
    assert _answers(days)._history.last_seen(_MUG) == _SCENE_TIME and _answers(days)._history.seen_in(_MUG) == ""
    assert _answer_on(days, "what is gone?").outcome == "cannot_say"
    before = 'By photos of 18 November 2026, nobody having looked on 19 November 2026: The "mug" is not where it was.'
    assert _answer_on(days, "where was the mug on 19 November?").sentence == before


def test_what_was_not_looked_at_is_told_beside_nothing() -> None:
    answer = _answer_on([(23, None)], "what is gone?", looked_at=(_LAMP,))
    assert answer.sentence == "Nothing is gone: photos of 23 November 2026 looked at 1 of 2 objects."


def test_a_missing_object_is_not_here_but_was_somewhere_on_a_day() -> None:
    days: _Days = [(23, "gone")]
    assert _answer_on(days, "when was the mug last seen?").outcome == "not_here"
    assert _answer_on(days, "where was the mug on Monday?").outcome == "here"
    assert _answer_on([(23, "moved")], "when was the mug last seen?").outcome == "here"


def test_without_another_day_the_day_of_the_scene_is_told() -> None:
    nothing = "Cannot say: no photos of another day are kept with this scene; the scene is of 20 November 2026."
    assert _answer_on([], "what is gone?").sentence == nothing


def test_of_many_changes_the_rest_is_counted() -> None:
    news = tuple(SceneChange("new", 0, "", 0.9, 0.0, None, _THERE, (0,), "") for _ in range(_MOST_TOLD + 2))
    sentence = _answer_on([(23, None)], "what is new?", changes=news).sentence
    assert sentence.endswith(" There are 2 more.") and sentence.count(" at (1.00, 2.00, 0.50) m.") == _MOST_TOLD


def test_what_was_no_object_is_told_as_gone_or_moved() -> None:
    changes = tuple(
        SceneChange(kind, 0, "", 0.9, 0.4, _THERE, after, (0,), "")
        for kind, after in (("gone", None), ("moved", _THERE))
    )
    days = "By photos of 23 November 2026: "
    for text, sentence in (
        ("what is gone?", "Something that was here is gone, at (1.00, 2.00, 0.50) m."),
        ("what moved?", "Something has moved by 0.40 m, to (1.00, 2.00, 0.50) m."),
    ):
        assert _answer_on([(23, None)], text, changes=changes).sentence == days + sentence
