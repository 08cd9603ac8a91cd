"""WordNet's database files (wndb(5WN)), memory-mapped and searched by bisection."""

from __future__ import annotations

import mmap
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from fastsplat.service.perception.models.model_manifest import find_model
from fastsplat_contract.errors import ModelUnavailableError

FILES = ("index.noun", "data.noun", "index.verb", "data.verb")

_LEXICAL_CLASSES = {
    **{3: "tops", 4: "act", 5: "animal", 6: "artifact", 7: "attribute", 8: "body", 9: "cognition"},
    **{10: "communication", 11: "event", 12: "feeling", 13: "food", 14: "group", 15: "location", 16: "motive"},
    **{17: "object", 18: "person", 19: "phenomenon", 20: "plant", 21: "possession", 22: "process", 23: "quantity"},
    **{24: "relation", 25: "shape", 26: "state", 27: "substance", 28: "time"},
}
"""Lexicographer files of nouns, lexnames(5WN)."""

_PLURALS = (
    *(("ses", "s"), ("xes", "x"), ("zes", "z"), ("ches", "ch"), ("shes", "sh"), ("men", "man"), ("ies", "y")),
    *(("ves", "f"), ("ves", "fe"), ("s", "")),
)
"""Plural endings and their singulars: the detachment rules of morphy(7WN), and two more."""


@dataclass(frozen=True)
class Sense:
    """A meaning of a noun."""

    id: int  # its place in the file, the same in every run
    lexical_class: str  # artifact, food, animal, ...; "" if unknown
    words: tuple[str, ...]  # synonyms, lower case
    definition: str  # without examples
    wider: tuple[int, ...]  # ids of hypernyms, also of instances
    parts: tuple[int, ...]  # ids of parts and substances


@dataclass(frozen=True)
class Verb:
    """A meaning of a verb."""

    words: tuple[str, ...]  # synonyms, lower case
    definition: str  # without examples
    wider: tuple[int, ...]  # ids of hypernyms


class Lexicon:
    """The nouns and verbs of WordNet; safe from several threads.

    Opening and queries raise `ModelUnavailableError` for missing, empty or contradictory files, and unknown ids.
    """

    def __init__(self, folder: Path, *, name: str = "wordnet") -> None:
        self.name = name
        with ExitStack() as opened:
            self._files = {file: opened.enter_context(self._mapped(folder / file)) for file in FILES}
            self._opened = opened.pop_all()
        self.senses = lru_cache(50_000)(self._senses)
        self.sense = lru_cache(50_000)(self._sense)
        self.wider = lru_cache(20_000)(self._wider)
        self.is_verb = lru_cache(5_000)(self._is_verb)
        self.verbs = lru_cache(5_000)(self._verbs)
        self.verb = lru_cache(20_000)(self._verb)

    def close(self) -> None:
        """Closes the files."""
        self._opened.close()

    def _is_verb(self, word: str) -> bool:
        """True if the word, uninflected, is a verb."""
        return self._line("index.verb", word) is not None

    def _senses(self, noun: str) -> tuple[Sense, ...]:
        """Returns a noun's senses, the most frequent first; case and plural endings do not matter."""
        for lemma in _singulars(" ".join(noun.lower().split())):
            if offsets := self._offsets("index.noun", lemma):
                return tuple(self.sense(offset) for offset in offsets)
        return ()

    def _verbs(self, word: str) -> tuple[Verb, ...]:
        """Returns the meanings of an uninflected verb, the most frequent first."""
        return tuple(self.verb(offset) for offset in self._offsets("index.verb", word))

    def _offsets(self, file: str, lemma: str) -> list[int]:
        """Places of a word's meanings in the data file."""
        line = self._line(file, lemma)
        if line is None:
            return []
        fields = line.split()
        try:
            count, pointers = int(fields[2]), int(fields[3])
            return [int(offset) for offset in fields[6 + pointers : 6 + pointers + count]]
        except (IndexError, ValueError) as error:
            raise self._damaged(file) from error

    def _sense(self, sense_id: int) -> Sense:
        lexical_class, words, pointers, definition = self._entry("data.noun", sense_id)
        nouns = [(symbol, offset) for symbol, offset, kind in pointers if kind == "n"]
        return Sense(
            id=sense_id,
            lexical_class=_LEXICAL_CLASSES.get(lexical_class, ""),
            words=words,
            definition=definition,
            wider=tuple(offset for symbol, offset in nouns if symbol in ("@", "@i")),
            parts=tuple(offset for symbol, offset in nouns if symbol in ("%p", "%s")),
        )

    def _verb(self, verb_id: int) -> Verb:
        _, words, pointers, definition = self._entry("data.verb", verb_id)
        above = tuple(offset for symbol, offset, kind in pointers if kind == "v" and symbol == "@")
        return Verb(words, definition, above)

    def _entry(self, file: str, place: int) -> tuple[int, tuple[str, ...], list[tuple[str, int, str]], str]:
        """Parses a data line: class number, words, pointers (symbol, place, part of speech), definition."""
        data = self._files[file]
        end = data.find(b"\n", place)
        fields, bar, gloss = data[place : end if end >= 0 else len(data)].decode("utf-8", "replace").partition(" | ")
        parts = fields.split()
        try:
            if not bar or int(parts[0]) != place:
                raise ValueError(place)
            words = int(parts[3], 16)
            at = 4 + 2 * words
            found = [parts[at + 1 + 4 * k : at + 5 + 4 * k] for k in range(int(parts[at]))]
            return (
                int(parts[1]),
                tuple(parts[4 + 2 * k].replace("_", " ").lower() for k in range(words)),
                [(symbol, int(offset), kind) for symbol, offset, kind, _ in found],
                gloss.split('; "')[0].strip(),
            )
        except (IndexError, ValueError) as error:
            raise self._damaged(file) from error

    def _wider(self, sense_id: int) -> Mapping[int, int]:
        """Maps each transitive hypernym to its distance in steps; the sense itself to 0."""
        distance, waiting = {sense_id: 0}, deque([sense_id])
        while waiting:
            below = waiting.popleft()
            for above in self.sense(below).wider:
                if above not in distance:
                    distance[above] = distance[below] + 1
                    waiting.append(above)
        return distance

    def _line(self, file: str, lemma: str) -> str | None:
        """Finds the line of a sorted index that begins with the lemma."""
        index, key = self._files[file], lemma.lower().replace(" ", "_").encode()
        low, high = 0, len(index)
        while low < high:
            middle = (low + high) // 2
            start = index.rfind(b"\n", low, middle) + 1 or low
            end = index.find(b"\n", middle)
            end = len(index) if end < 0 else end
            line = index[start:end]
            word = b"" if line.startswith(b" ") else line.partition(b" ")[0]  # the license comes first, indented
            if word == key:
                return line.decode("utf-8", "replace") if key else None
            low, high = (end + 1, high) if word < key else (low, start)
        return None

    def _mapped(self, path: Path) -> mmap.mmap:
        try:
            with path.open("rb") as file:
                return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:  # mmap refuses empty files by ValueError
            raise ModelUnavailableError(
                f"model {self.name}: {path.name} is missing or empty",
                field=path.name,
                hint="Fetch it with: fastsplat models pull wordnet",
            ) from error

    def _damaged(self, file: str) -> ModelUnavailableError:
        return ModelUnavailableError(
            f"model {self.name}: {file} is not a file of WordNet, or belongs to another release",
            field=file,
            hint="Fetch it again with: fastsplat models pull wordnet",
        )


def _singulars(noun: str) -> Iterator[str]:
    """Yields the noun, then its possible singulars."""
    yield noun
    for ending, singular in _PLURALS:
        if noun.endswith(ending) and len(noun) > len(ending) + 1:
            yield noun.removesuffix(ending) + singular


def open_lexicon(name: str, models: Path) -> Lexicon:
    """Opens a lexicon by manifest entry or "wordnet:my_folder"; may raise `ModelUnavailableError`."""
    _, inside = find_model(name, "lexicon")
    return Lexicon(models / inside, name=name)


def find_lexicon(name: str, models: Path) -> Lexicon | None:
    """Opens a lexicon as `open_lexicon`; None if unnamed or never fetched."""
    if not name:
        return None
    _, inside = find_model(name, "lexicon")
    return open_lexicon(name, models) if (models / inside).is_dir() else None
