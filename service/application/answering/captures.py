"""Captures of one place, which share a frame: listed by date, and asked as one, the newest that saw the spot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.application.answering.all_scenes import MAX_SKIPPED, AllScenes, AskOne
from fastsplat.service.application.answering.open_scenes import OpenScenes
from fastsplat.service.application.base.paging import page_of
from fastsplat.service.application.base.validate import check_texts
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.language.query_text import TextQuery
from fastsplat.service.scene.capture_times import newest_photo_at
from fastsplat.service.store.damaged_rows import decodes, each_readable
from fastsplat.service.store.records import SceneRecord
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.queries import Answer, Outcome, QueryOut, QueryRequest

if TYPE_CHECKING:  # torch loads when it is used
    from fastsplat.service.query.scene_index import SceneIndex
    from fastsplat.service.query.things.place_sight import PlaceSight

_MAX_THINGS = 16
"""Of an answer, whose places are looked at in newer captures."""
_MAX_POINTS = 256
"""Of a thing."""
_HERE: tuple[Outcome, ...] = ("here", "probably_here")

Days = Callable[[str], str]
"""When the photos of a capture were taken, in words, by its scene's id."""


class Captures:
    """The captures of a project's places. Every method is safe from any thread.

    Args:
        store, scenes: of one project.
        all_scenes: of that store.
        ask_one: opens the scene that a request names.
    """

    def __init__(self, store: Store, scenes: OpenScenes, all_scenes: AllScenes, ask_one: AskOne) -> None:
        self._store, self._scenes = store, scenes
        self._all_scenes, self._ask_one = all_scenes, ask_one

    def page(self, place: str, size: int, page_token: str) -> tuple[Sequence[SceneRecord], str]:
        """At most `size` captures of the place of a finished scene, the newest photos first, and the token of the next
        page; as `SceneService.list_scenes`.

        Raises:
            NotFoundError: there is no such scene.
            NotReadyError: it is not finished, or the scene whose frame it is lies in another one now.
            InvalidInputError: a token that no page returned.
        """
        check_texts(place, "place")
        captures = self._of(place)
        return page_of(captures, size, page_token, f"captures {' '.join(each.id for each in captures)}")

    def query(self, query: TextQuery, request: QueryRequest) -> QueryOut:
        """One answer a text: of the newest capture that shows what is asked for, unless a newer one saw its place.
        Where that is empty, the thing is not there any more; what else may be meant in that capture is preferred to it.
        Captures that were not asked are named.

        Args:
            query: what is asked.
            request: the same, with the outputs, of any of the captures; cameras and where the asker stands are in the
                frame that all share.

        Raises:
            NotFoundError, NotReadyError: as `page`, and as `Answers.query`.
            InvalidInputError: no scene, or views or a version, which belong to one capture.
        """
        _check_of_place(request)
        captures = self._of(request.scene_id)
        request = replace(request, newest_capture=False)  # from here on each of them is asked alone
        ranking = replace(request, outputs=frozenset())
        ids = [each.id for each in captures]
        asked, skipped = self._all_scenes.asked(query, ranking, ids)
        if not asked:  # as whoever asks it alone hears it
            return QueryOut(self._ask_one(query, request))
        days = _days(captures)
        answers = [newest_that_knows(each, self._looking_for, days) for each in zip(*asked, strict=True)]
        if request.outputs:
            answers = [self._complete(answer, query, request) for answer in answers]
        return QueryOut(tuple(answers), tuple(skipped[:MAX_SKIPPED]), len(skipped))

    def _of(self, scene_id: str) -> Sequence[SceneRecord]:
        self._scenes.finished(scene_id)
        found = each_readable(self._store.scenes.captures(scene_id), lambda each: (_taken(each), each))
        found.sort(key=lambda each: (each[0], each[1].created_at, each[1].id), reverse=True)
        return [each for _, each in found]

    def _looking_for(self, answer: Answer) -> Callable[[Answer], PlaceSight]:
        """What other captures, by their answers, saw of the places of what one answers."""
        places = self._scenes.reading(answer.scene_id, answer.version, lambda index, _: _places(index, answer))

        def sight(other: Answer) -> PlaceSight:
            check_cancelled()
            return self._scenes.reading(other.scene_id, other.version, lambda index, _: _sight(index, places))

        return sight

    def _complete(self, answer: Answer, query: TextQuery, request: QueryRequest) -> Answer:
        """The same answer with the outputs that are asked for."""
        one = replace(request, scene_id=answer.scene_id, texts=(answer.text,), version=answer.version)
        (full,) = self._ask_one(replace(query, texts=one.texts), one)
        return replace(_saying(full, answer.sentence), outcome=answer.outcome)


def newest_that_knows(
    answers: Sequence[Answer], looking_for: Callable[[Answer], Callable[[Answer], PlaceSight]], days: Days
) -> Answer:
    """What counts of the answers of all captures of a place to one text, with its day in the sentence.

    Args:
        answers: the newest first, at least one.
        looking_for: of an answer: what the captures of others saw of its place.
        days: of the captures.
    """
    of = {outcome: each for outcome in reversed(_HERE) for each in reversed(answers) if each.outcome == outcome}
    best = of.get("here") or of.get("probably_here") or answers[0]
    newer = answers[: answers.index(best)]
    told = f"By the capture of {days(best.scene_id)}"
    if not newer:
        return _saying(best, f"{told}: {best.sentence}")
    sight_of = looking_for(best)
    for other in newer:
        sight = sight_of(other)
        if sight == "unseen":
            continue
        day = days(other.scene_id)
        if other.outcome in _HERE:
            return _saying(other, f"By the capture of {day}: {other.sentence}")
        if sight == "empty":
            empty = "its place, which is empty" if len(best.things) < 2 else "their places, which are empty"
            sentence = f"Not here any more: the capture of {day} saw {empty}. {told}: {best.sentence}"
            return replace(_saying(other, sentence), outcome="not_here")
        filled = f"that of {day} has something in its place that has no such name"
        return _saying(best, f"{told}; {filled}: {best.sentence}")
    return _saying(best, f"{told}, as no later one saw its place: {best.sentence}")


def _places(index: SceneIndex, answer: Answer) -> Sequence[NDArray[np.float64]]:
    """Where what answers is: float64 [K, 3] of each thing, world frame."""
    gaussians = index.scene.gaussians
    things = [index.things.rows((each,)) for each in answer.things[:_MAX_THINGS]] or [index.mask3d(answer)]
    found = [np.flatnonzero(rows & (gaussians.logit_opacities > 0)) for rows in things]
    return [gaussians.means[rows[:: -(-len(rows) // _MAX_POINTS)]].astype(np.float64) for rows in found if len(rows)]


def _sight(index: SceneIndex, places: Sequence[NDArray[np.float64]]) -> PlaceSight:
    """What a capture saw of all these places: the least of what it saw of each."""
    from fastsplat.service.query.things.place_sight import place_sights

    seen = set(place_sights(index.scene, places))
    if not seen or "unseen" in seen:
        return "unseen"
    return "filled" if "filled" in seen else "empty"


def _check_of_place(request: QueryRequest) -> None:
    if not request.scene_id:
        raise InvalidInputError(
            "the newest capture of no place", field="scene_id", hint="Name a scene of the place, any of its captures."
        )
    alone = {"views": request.views, "asker_view": request.asker_view, "version": request.version}
    for field, sent in alone.items():
        if sent:
            raise InvalidInputError(
                f"{field} of one capture, of a question to all of a place",
                field=field,
                hint="Leave it out, send a camera or a pose instead, or ask that capture alone.",
            )


@decodes("scene")
def _taken(capture: SceneRecord) -> datetime:
    return newest_photo_at(capture.quality) or datetime.fromtimestamp(capture.created_at, UTC)


def _days(captures: Sequence[SceneRecord]) -> Days:
    """Days, with the time where several captures are of one day."""
    taken = {each.id: _taken(each) for each in captures}

    def day(scene_id: str) -> str:
        at = taken[scene_id]
        alone = sum(other.date() == at.date() for other in taken.values()) == 1
        return f"{at.day} {at:%B %Y}" + ("" if alone else f", {at:%H:%M} UTC")

    return day


def _saying(answer: Answer, sentence: str) -> Answer:
    return replace(answer, sentence=sentence)
