"""The questions to an assistant's tools: what is true of them, and that an answer beside the truth is not right."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.absence.questions import calibrating_keys, read_cases
from benchmarks.assistant.questions import Question, is_right, read_questions
from benchmarks.assistant.rooms import Layout, layouts
from fastsplat.service.common.dictionary import label_key

ROOMS = {layout.name: layout for layout in layouts()}
QUESTIONS = read_questions(tuple(ROOMS.values()))


def test_nothing_was_fitted_to_other_words_and_to_absences() -> None:
    fitted = calibrating_keys() | {label_key(case.question) for case in read_cases()}
    keys = {label_key(question.text) for question in QUESTIONS if question.kind in ("names", "absent")}
    assert not keys & fitted
    for question in QUESTIONS:
        names = {label_key(obj.name) for obj in ROOMS[question.room].room.objects}
        assert question.kind not in ("names", "absent") or label_key(question.text) not in names


def _truth(question: Question, layout: Layout) -> dict[str, Any]:
    """What a tool that is never wrong would say."""
    ids = list(question.objects or ())
    objects = [{"id": number, "name": layout.room.objects[number - 1].name} for number in ids]
    places = [{"id": number, "center": layout.center(number)} for number in ids]
    lengths: dict[str, Any] = {}
    if question.kind == "size":
        lengths["sides"] = [{"value": side} for side in layout.size(ids[0])]
    if question.kind == "distance":
        between = np.linalg.norm(np.subtract(*(layout.center(number) for number in ids)))
        lengths = {"distance": {"value": layout.distance(*ids)}, "center_distance": {"value": between}}
    return {
        "outcome": "here" if ids else "not_here",
        "label": question.names[0] if question.names else "",
        "alternatives": [],
        "objects": objects,
        "places": places,
        "count": len(ids),
        "counted": ids,
        "refusal": "" if question.objects is not None else "pose_needed",
        "unit": "m",
        **lengths,
    }


def _wrong(question: Question, said: dict[str, Any]) -> dict[str, Any]:
    """The same with one object, place or length wrong."""
    if question.tool == "measure":
        key = "sides" if question.kind == "size" else "center_distance"
        first = said[key][0] if question.kind == "size" else said[key]
        longer = {"value": 1.07 * first["value"] + 0.03}
        return {**said, key: [longer, *said["sides"][1:]] if question.kind == "size" else longer}
    if said["places"] and question.kind == "where":
        moved = {**said["places"][0], "center": np.asarray(said["places"][0]["center"]) + 0.02}
        return {**said, "places": [moved, *said["places"][1:]]}
    more = [*said["objects"], {"id": 77, "name": "cuckoo", "center": (0.0, 0.0, 0.0)}]
    return {**said, "objects": more, "counted": [*said["counted"], 77], "places": more, "refusal": ""}


def test_the_truth_is_right_and_what_is_beside_it_is_not() -> None:
    for question in QUESTIONS:
        layout = ROOMS[question.room]
        said = _truth(question, layout)
        assert is_right(question, said, layout), question
        assert not is_right(question, _wrong(question, said), layout), question
