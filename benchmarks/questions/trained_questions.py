"""The questions of `questions.txt`, and which objects of a trained scene they are about."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.calibration.lists import names_of

FILE = Path(__file__).with_name("questions.txt")
NO_KEYS = ("near", "far", "nonsense", "foreign")
KINDS = ("name", "synonym", "kind", "use", "plural", "color", "relation", "superlative", "count", *NO_KEYS)
Part = Literal["mending", "scored", "doll"]
_LINE = re.compile(r"(?P<kind>[a-z]+)(?: \[(?P<view>[^]]+)\])?: (?P<rest>.+)")
_TRUTH = re.compile(r"(?:(?P<count>\d+):)?\s*(?P<keys>[^(]*)(?:\((?P<also>[^)]*)\))?")


@dataclass(frozen=True)
class PhotoObject:
    """Something that photos show.

    Attributes:
        key: by which questions speak of it.
        places: photo, x and y of pixels on it, as shares of width and height.
        names: what it is rightly called.
    """

    key: str
    places: tuple[tuple[str, float, float], ...]
    names: tuple[str, ...]


@dataclass(frozen=True)
class Question:
    """A question and its truth.

    Attributes:
        scene: that it is about.
        kind: one of `KINDS`.
        text: as asked.
        view: the photo from whose place it is asked; "" for none.
        keys: of the objects that must be shown; none: nothing is what it asks for.
        also: of those that may be shown beside them.
        count: how many there are, where that is asked.
    """

    scene: str
    kind: str
    text: str
    view: str = ""
    keys: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    count: int | None = None

    @property
    def part(self) -> Part:
        """Which part of the list it belongs to, see `benchmarks.questions`."""
        if self.scene == "plush":
            return "doll"
        return "scored" if hashlib.sha256(f"{self.scene}: {self.text}".encode()).digest()[0] & 1 else "mending"


@dataclass(frozen=True)
class Photographed:
    """One scene's objects and questions."""

    name: str
    objects: tuple[PhotoObject, ...]
    questions: tuple[Question, ...]


def read_scenes(path: Path = FILE) -> list[Photographed]:
    """The scenes, in order.

    Raises:
        ValueError: a line of no known kind, or of an object that is none; names it.
    """
    objects: dict[str, list[PhotoObject]] = {}
    questions: dict[str, list[Question]] = {}
    name = ""
    for number, line in enumerate(path.read_text().splitlines(), start=1):
        if not line or line.startswith("#"):
            continue
        if line.startswith("["):
            name = line.strip("[]")
            objects[name], questions[name] = [], []
        elif line.startswith("object "):
            objects[name].append(object_of(line.removeprefix("object ")))
        else:
            line_questions = list(_questions(name, line, number))
            unknown = {key for question in line_questions for key in (*question.keys, *question.also)} - {
                obj.key for obj in objects[name]
            }
            if unknown:
                raise ValueError(f"line {number}: {sorted(unknown)} are no objects of {name}")
            questions[name] += line_questions
    return [Photographed(name, tuple(objects[name]), tuple(questions[name])) for name in objects]


def object_of(line: str) -> PhotoObject:
    """What a line behind the word "object" says."""
    key, rest = line.split(": ", 1)
    places, names = rest.split(" = ")
    parsed = [place.split() for place in places.split("|")]
    return PhotoObject(key, tuple((photo, float(x), float(y)) for photo, x, y in parsed), tuple(names_of(names)))


def _questions(scene: str, line: str, number: int) -> Iterator[Question]:
    parsed = _LINE.fullmatch(line)
    if parsed is None or parsed["kind"] not in KINDS:
        raise ValueError(f"line {number}: {line!r} is no question")
    kind, rest = parsed["kind"], parsed["rest"]
    if kind in NO_KEYS:
        yield from (Question(scene, kind, text.strip()) for text in rest.split(", "))
        return
    text, arrow, truth = (part.strip() for part in rest.partition("->"))
    match = _TRUTH.fullmatch(truth)
    if not arrow or match is None or (kind == "count") != (match["count"] is not None):
        raise ValueError(f"line {number}: {truth!r} is no truth of kind {kind}")
    keys = () if match["keys"].strip() == "nothing" else tuple(names_of(match["keys"]))
    count = None if match["count"] is None else int(match["count"])
    yield Question(scene, kind, text, parsed["view"] or "", keys, tuple(names_of(match["also"] or "")), count)


def views_by_photo(views: Sequence[str]) -> Mapping[str, str]:
    """The scene's names of its cameras, by the file names of their photos."""
    return {view.rsplit("/", 1)[-1]: view for view in views}


def objects_of(
    objects: Sequence[PhotoObject], views: Mapping[str, str], object_map: Callable[[str], NDArray[np.uint16]]
) -> Mapping[str, int]:
    """By key, the object that most of the pixels of each object show; without those that none shows.

    Args:
        objects: of the scene.
        views: of the scene, by their photos: those that have a place in it.
        object_map: ids [H, W] of the objects that a view shows, 0 for none.
    """
    ids = {}
    for obj in objects:
        numbers = []
        for photo, x, y in obj.places:
            if photo in views:
                drawn = object_map(views[photo])
                row, column = int(y * drawn.shape[0]), int(x * drawn.shape[1])
                numbers.append(int(drawn[row, column]))
        counted = Counter(number for number in numbers if number)
        if counted:
            ids[obj.key] = counted.most_common(1)[0][0]
    return ids
