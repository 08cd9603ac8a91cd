"""The questions of `questions.txt`: what is there under another name, and what is not there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.calibration.lists import names_of, read_pairs, read_scenes
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.language.meaning.common_objects import FILE as LISTED

FILE = Path(__file__).with_name("questions.txt")
FITTED = FILE.parents[1] / "calibration" / "lists.txt"
"""Cases of the same six lists that may fit the answers."""
COMPOUNDS = FITTED.with_name("compounds.txt")
"""Cases that may fit them, too, of five lists more."""
PRESENT = ("synonym", "kind", "use")
ABSENT = ("far", "household", "near")
_SIMILAR = 0.75
"""Of the words of two questions together, from which on they are one question said twice."""
_LITTLE_WORDS = frozenset("a an the of in on to for with my your some something and or at by from".split())
_PRESENT_TOO = ("compound", "standin")
_ABSENT_TOO = ("feigned", "other", "sibling")


@dataclass(frozen=True)
class Case:
    """One question to one dictionary; `answers` are the labels that may lead, none where it should be absent."""

    scene: str
    labels: tuple[str, ...]
    list: str
    question: str
    answers: tuple[str, ...]


def read_cases(path: Path = FILE) -> list[Case]:
    """The cases of `questions.txt`, in order.

    Raises:
        ValueError: a line of no known list, or an answer that is no label; names the line.
    """
    cases: list[Case] = []
    scene, labels = "", tuple[str, ...]()
    for number, line in enumerate(path.read_text().splitlines(), start=1):
        if not line or line.startswith("#"):
            continue
        if line.startswith("["):
            scene, _, rest = line[1:].partition("]")
            labels = names_of(rest)
            continue
        kind, _, rest = line.partition(":")
        if kind in PRESENT + _PRESENT_TOO:
            question, _, answers = rest.partition("->")
            new = [Case(scene, labels, kind, question.strip(), names_of(answers))]
            if not new[0].answers or not set(new[0].answers) <= set(labels):
                raise ValueError(f"line {number}: {answers.strip()!r} is no label of {scene}")
        elif kind in ABSENT + _ABSENT_TOO:
            new = [Case(scene, labels, kind, question, ()) for question in names_of(rest)]
        else:
            raise ValueError(f"line {number}: {kind!r} is none of {PRESENT + _PRESENT_TOO + ABSENT + _ABSENT_TOO}")
        cases += new
    return cases


def content_words(question: str) -> tuple[str, ...]:
    """The words of a question that say what it is about, in their basic forms and their order."""
    return tuple(label_key(word) for word in question.lower().split() if word not in _LITTLE_WORDS)


def said_alike(left: tuple[str, ...], right: tuple[str, ...]) -> bool:
    """Whether two questions, by their `content_words`, are one with a word more or less. Of two words the order counts:
    a soap dish is no dish soap. Words that stand alone are compared by their keys."""
    if min(len(left), len(right)) < 3:
        return len(left) > 1 and left == right
    first, second = set(left), set(right)
    return len(first & second) >= _SIMILAR * len(first | second)


def calibrating_keys() -> set[str]:
    """Keys of every question that thresholds or weights are fitted to."""
    keys = {label_key(pair.query) for pair in read_pairs()}
    keys |= {label_key(question.query) for scene in read_scenes() for question in scene.questions}
    return keys | {label_key(case.question) for path in (FITTED, COMPOUNDS) for case in read_cases(path)}


def listed_keys() -> set[str]:
    """Keys of all that the product's own list of common objects holds word by word: names, kinds and uses."""
    parts = (part for line in LISTED.read_text().splitlines() for part in re.split(r"[|,;]", line))
    return {label_key(part) for part in parts}


def doubles(cases: list[Case]) -> Iterator[str]:
    """What is wrong with the lists, a sentence each: questions that stand twice, that bear a name of what is there, or
    that stand, with other little words or a word more, in a list that calibrates."""
    calibrating = calibrating_keys()
    by_word: dict[str, list[tuple[str, ...]]] = {}
    for words in {content_words(key) for key in calibrating}:
        for word in words:
            by_word.setdefault(word, []).append(words)
    first: dict[str, Case] = {}
    for case in cases:
        key = label_key(case.question)
        if key in first:
            yield f"{case.question!r} stands in {first[key].scene}, {first[key].list}, and in {case.scene}, {case.list}"
        first.setdefault(key, case)
        if key in calibrating:
            yield f"{case.question!r} of {case.scene} calibrates"
        mine = content_words(case.question)
        if any(said_alike(mine, words) for word in mine for words in by_word.get(word, ())):
            yield f"{case.question!r} of {case.scene} calibrates in other words"
        names = [label_key(label) for label in case.labels]
        borne = (
            [name for name in names if f" {name} " in f" {key} "] if case.answers else [n for n in names if n == key]
        )
        if borne:
            yield f"{case.question!r} of {case.scene} bears the name {borne[0]!r}"
