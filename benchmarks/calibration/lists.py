"""The judgements that calibrate a text encoder: pairs of a label and a query, and whole dictionaries with questions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Pair:
    """What somebody who asks for `query` thinks of being shown `label`: `kind` is exact, related or absent."""

    label: str
    query: str
    kind: str
    sets: bool


@dataclass(frozen=True)
class Question:
    """A query to a whole dictionary: acceptable first answers (none: it should be absent), and entries that may be
    listed beside them."""

    query: str
    answers: tuple[str, ...]
    also: tuple[str, ...] = ()


@dataclass(frozen=True)
class Questions:
    """One dictionary with its questions."""

    name: str
    labels: tuple[str, ...]
    questions: tuple[Question, ...]


def read_pairs(path: Path = HERE / "pairs.txt") -> list[Pair]:
    """The judgements of `pairs.txt`; labels in even lines set thresholds, those in odd lines judge them."""
    pairs: list[Pair] = []
    lines = [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
    for number, line in enumerate(lines):
        label, *kinds = (part.strip() for part in line.split("|"))
        for part in kinds:
            kind, queries = part.split(":", 1)
            pairs += [Pair(label, query, kind.strip(), number % 2 == 0) for query in names_of(queries)]
    return pairs


def read_scenes(path: Path = HERE / "scenes.txt") -> list[Questions]:
    """The dictionaries of `scenes.txt`, in order."""
    found: list[tuple[str, tuple[str, ...], list[Question]]] = []
    for line in path.read_text().splitlines():
        if line.startswith("["):
            name, labels = line[1:].split("]")
            found.append((name, names_of(labels), []))
        elif line and not line.startswith("#"):
            queries, answers = line.split("->")
            first, _, also = answers.partition(";")
            wanted = () if first.strip() == "nothing" else names_of(first)
            found[-1][2].extend(Question(query, wanted, names_of(also)) for query in names_of(queries))
    return [Questions(name, labels, tuple(questions)) for name, labels, questions in found]


def names_of(text: str) -> tuple[str, ...]:
    """The names of a list with commas."""
    return tuple(part.strip() for part in text.split(",") if part.strip())
