"""The questions of `questions.txt` and what makes an answer right: the placing, never what the service says."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.assistant.rooms import Layout
from benchmarks.calibration.lists import names_of

FILE = Path(__file__).with_name("questions.txt")
PLACE_OFF = 0.03
"""Meters that an object's middle may be off."""
LENGTH_OFF, SHARE_OFF = 0.02, 0.05
"""Meters, or the share of a length, that it may be off, whichever is more."""
_ABSENT = ("not_here", "not_seen")
_LINE = re.compile(r"(?P<kind>[a-z ]+?)(?: \[(?P<view>[^]]+)\])?: (?P<rest>.+)")


@dataclass(frozen=True)
class Question:
    """A call of a tool and its truth.

    Attributes:
        room: that it is about.
        kind: of the lines of `questions.txt`.
        text: of the question; of a measurement its keys.
        view: from which left and right are meant; "" for none.
        names: of which one must lead.
        objects: ids; None where the placing decides nothing.
    """

    room: str
    kind: str
    text: str
    view: str = ""
    names: tuple[str, ...] = ()
    objects: tuple[int, ...] | None = ()

    @property
    def tool(self) -> str:
        """Which one is asked."""
        return {"relations": "relations", "size": "measure", "distance": "measure"}.get(self.kind, "find")

    def arguments(self) -> dict[str, Any]:
        """Of the call, without the scene."""
        if self.tool == "measure":
            assert self.objects
            return dict(zip(("first", "second"), self.objects, strict=False))
        return {"text": self.text} | ({"view": self.view} if self.view else {})


def read_questions(layouts: Sequence[Layout], path: Path = FILE) -> list[Question]:
    """The questions, in order.

    Raises:
        ValueError: a line of no known kind; names it.
        KeyError: a key or a room that is not there.
    """
    rooms = {layout.name: layout for layout in layouts}
    questions: list[Question] = []
    layout = layouts[0]
    for number, line in enumerate(path.read_text().splitlines(), start=1):
        if not line or line.startswith("#"):
            continue
        if line.startswith("["):
            layout = rooms[line.strip("[]")]
            continue
        parsed = _LINE.fullmatch(line)
        if parsed is None:
            raise ValueError(f"line {number}: {line!r} is no question")
        questions += _questions(layout, parsed["kind"], parsed["view"] or "", parsed["rest"], number)
    return questions


def is_right(question: Question, said: Mapping[str, Any], layout: Layout) -> bool:
    """Whether what a tool returned is the truth.

    Args:
        question: that was asked.
        said: the tool's structured result.
        layout: of its room.
    """
    judges = {
        "find": _names_right,
        "names": _names_right,
        "absent": lambda question, said, layout: said["outcome"] in _ABSENT and not said["objects"],
        "count": _count_right,
        "count of": _count_right,
        "relations": _relation_right,
        "where": _places_right,
        "size": _lengths_right,
        "distance": _lengths_right,
    }
    return bool(judges[question.kind](question, said, layout))


def _questions(layout: Layout, kind: str, view: str, rest: str, number: int) -> Iterator[Question]:
    text, arrow, truth = (part.strip() for part in rest.partition("->"))
    if kind == "absent":
        yield from (Question(layout.name, kind, name) for name in names_of(text))
    elif kind in ("size", "distance"):
        ends = [key.strip() for key in text.split("|")]
        if len(ends) != 1 + (kind == "distance"):
            raise ValueError(f"line {number}: {text!r} is not to be measured")
        yield Question(layout.name, kind, text, objects=tuple(layout.ids[key] for key in ends))
    elif kind in ("find", "names", "count") and arrow:
        names = names_of(truth)
        objects = frozenset().union(*(layout.bearing(name) for name in names))
        if bool(names) != bool(objects) or (kind != "count" and not names):
            raise ValueError(f"line {number}: nothing bears {truth!r}")
        yield Question(layout.name, kind, text, names=names, objects=tuple(sorted(objects)))
    elif kind in ("count of", "relations", "where") and arrow:
        keys: Sequence[str] = () if truth in ("nothing", "refused") else names_of(truth)
        ids = None if truth == "refused" else tuple(sorted(layout.ids[key] for key in keys))
        yield Question(layout.name, kind, text, view, objects=ids)
    else:
        raise ValueError(f"line {number}: {kind!r} is no kind of question")


def _names_right(question: Question, said: Mapping[str, Any], layout: Layout) -> bool:
    """The label, and every object that bears it and none of another name than was said."""
    answered = {obj["id"] for obj in said["objects"]}
    named = {obj["name"] for obj in said["objects"]} <= {said["label"], *said["alternatives"]}
    return (
        said["outcome"] not in _ABSENT
        and said["label"] in question.names
        and named
        and layout.bearing(said["label"]) <= answered
    )


def _count_right(question: Question, said: Mapping[str, Any], layout: Layout) -> bool:
    assert question.objects is not None
    return bool(said["count"] == len(question.objects) and sorted(said["counted"]) == list(question.objects))


def _relation_right(question: Question, said: Mapping[str, Any], layout: Layout) -> bool:
    answered = sorted(obj["id"] for obj in said["objects"])
    if question.objects is None:
        return bool(said["refusal"]) and not answered
    return not said["refusal"] and answered == list(question.objects)


def _places_right(question: Question, said: Mapping[str, Any], layout: Layout) -> bool:
    assert question.objects is not None
    places = {place["id"]: np.array(place["center"]) for place in said["places"]}
    if sorted(places) != list(question.objects) or (said["outcome"] in _ABSENT) != (not places):
        return False
    off = [float(np.linalg.norm(layout.center(number) - place)) for number, place in places.items()]
    return said["unit"] == "m" and max(off, default=0.0) <= PLACE_OFF


def lengths(question: Question, said: Mapping[str, Any], layout: Layout) -> list[tuple[Mapping[str, float], float]]:
    """Each length that a measurement says, with value, low and high, and the truth; edges from the shortest on."""
    assert question.objects is not None
    if question.kind == "size":
        sides = sorted(said["sides"], key=lambda side: float(side["value"]))
        return list(zip(sides, layout.size(question.objects[0]).tolist(), strict=True))
    first, second = question.objects
    between = float(np.linalg.norm(layout.center(first) - layout.center(second)))
    return [(said["distance"], layout.distance(first, second)), (said["center_distance"], between)]


def _lengths_right(question: Question, said: Mapping[str, Any], layout: Layout) -> bool:
    return said["unit"] == "m" and all(
        abs(length["value"] - truth) <= max(LENGTH_OFF, SHARE_OFF * truth)
        for length, truth in lengths(question, said, layout)
    )
