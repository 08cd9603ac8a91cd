"""Search for words in what photos show written on objects, tolerating misread letters."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from fastsplat.service.common.edit_distance import text_difference
from fastsplat.service.scene.artefact.scene import Object
from fastsplat_contract.messages.object_reads import ObjectRead, ReadKind

_ALIKE = 0.2
"""Largest share of differing letters of the same word: one of five."""
_WORD = re.compile(r"\w+")
_KINDS: Mapping[ReadKind, tuple[str, ...]] = {
    "text": (),
    "qr": ("qr", "code"),
    "barcode": ("barcode", "bar", "code"),
    "tag": ("tag", "apriltag"),
}
"""Names of codes, so that "tag 12" is the one with the number 12."""

_WHERE_IT_SAYS = re.compile(r"^\W*(?:where|on what|on which \w+) does it (?:say|read)\s+(?=\S)", re.IGNORECASE)
_WHERE_WRITTEN = re.compile(
    r"^\W*(?:where|on what) (?:is|are)\s+(\S.*?)\s+(?:written|printed)(?: on)?\W*$", re.IGNORECASE
)


def asked_of_writing(text: str) -> str:
    """Rewrites "where does it say oat milk?" as "something that says oat milk"."""
    return _WHERE_WRITTEN.sub(r"something that says \1", _WHERE_IT_SAYS.sub("something that says ", text))


@dataclass(frozen=True)
class WrittenWords:
    """Writing on one scene's objects; thread-safe."""

    objects: tuple[Object, ...] = field(repr=False)  # of the scene; only those with reads count

    @cached_property
    def _lines(self) -> tuple[tuple[int, tuple[tuple[float, tuple[str, ...]], ...]], ...]:
        """Probability and words of each read, by object."""
        with_reads = [obj for obj in self.objects if obj.reads]
        return tuple((obj.id, tuple((read.probability, _words(read)) for read in obj.reads)) for obj in with_reads)

    def bearing(self, text: str) -> Mapping[int, float]:
        """Objects with all words of a text, likeliest first, with probabilities 0..1.

        Lines and order do not matter; the least probable word counts. Numbers must be equal; other words may differ in
        one letter of five, which lowers the probability by that share."""
        words = tuple(_WORD.findall(text.casefold()))
        if not words:
            return {}
        likely = {
            obj: min(max(probability * _likeness(word, line) for probability, line in lines) for word in words)
            for obj, lines in self._lines
        }
        return dict(sorted(((obj, chance) for obj, chance in likely.items() if chance), key=lambda pair: -pair[1]))

    def leading(self, words: Sequence[str]) -> int:
        """Largest number of leading words that are written on one object."""
        most = 0
        for count in range(1, len(words) + 1):
            if not self.bearing(" ".join(words[:count])):
                break
            most = count
        return most


def _words(read: ObjectRead) -> tuple[str, ...]:
    words = _WORD.findall(read.text.casefold())
    return (*_KINDS[read.kind], *words, "".join(words))


def _likeness(word: str, words: Sequence[str]) -> float:
    """Likeness of a word to the closest of others, 0..1."""
    if word in words:
        return 1.0
    if any(letter.isdigit() for letter in word):
        return 0.0
    difference = min((text_difference(word, other_word, _ALIKE) for other_word in words), default=1.0)
    return 1.0 - difference if difference <= _ALIKE else 0.0
