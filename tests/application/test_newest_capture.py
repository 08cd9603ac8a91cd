"""Which of the answers of a place's captures counts, by what each newer capture saw."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from fastsplat.service.application.answering.captures import newest_that_knows
from fastsplat.service.query.things.place_sight import PlaceSight
from fastsplat_contract.queries import Answer, Outcome


def _answer(scene_id: str, outcome: Outcome, things: tuple[int, ...] = (1,)) -> Answer:
    return Answer(
        scene_id=scene_id,
        text="mug",
        sentence=f"{outcome}.",
        outcome=outcome,
        probability=None,
        label_set=(),
        matches=(),
        masks=(),
        things=things,
        coverage=0.9,
        version="1",
        gaussians=9,
        match_count=0,
    )


def _told(saw: PlaceSight, *answers: Answer) -> Answer:
    def looking_for(best: Answer) -> Callable[[Answer], PlaceSight]:
        return lambda other: saw

    return newest_that_knows(answers, looking_for, lambda scene_id: f"the day of {scene_id}")


@pytest.mark.parametrize("outcome", ["not_here", "not_seen", "cannot_say"])
def test_an_empty_place_is_not_here_whatever_else_its_capture_cannot_say(outcome: Outcome) -> None:
    old = _answer("old", "here")
    told = _told("empty", _answer("new", outcome), old)
    assert (told.scene_id, told.outcome) == ("new", "not_here")
    assert told.sentence == (
        "Not here any more: the capture of the day of new saw its place, which is empty. "
        "By the capture of the day of old: here."
    )
    several = _told("empty", _answer("new", outcome), replace(old, things=(1, 2)))
    assert "saw their places, which are empty." in several.sentence


@pytest.mark.parametrize("outcome", ["not_here", "not_seen", "cannot_say"])
@pytest.mark.parametrize("saw", ["unseen", "filled"])
def test_a_newer_capture_that_saw_no_empty_place_takes_nothing_away(outcome: Outcome, saw: PlaceSight) -> None:
    told = _told(saw, _answer("new", outcome), _answer("old", "here"))
    assert (told.scene_id, told.outcome) == ("old", "here") and told.sentence.endswith("here.")


def test_what_is_surely_there_is_preferred_to_what_may_be_in_a_newer_capture_that_saw_nothing_there() -> None:
    newest, old, older = _answer("newest", "probably_here"), _answer("old", "here"), _answer("older", "here")
    assert _told("unseen", newest, old, older).scene_id == "old"
    assert _told("empty", newest, old, older).scene_id == "newest"
    assert _told("filled", newest, old, older).outcome == "probably_here"


def test_where_no_capture_knows_it_the_newest_answers() -> None:
    told = _told("empty", _answer("new", "not_seen"), _answer("old", "not_here"))
    assert (told.scene_id, told.outcome, told.sentence) == (
        "new",
        "not_seen",
        "By the capture of the day of new: not_seen.",
    )
