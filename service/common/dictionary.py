"""The scene's hash table of labels (FAST-Splat, section 4: the dictionary of identified objects)."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

from fastsplat_contract.errors import InvalidInputError

UNDETECTED = 0
"""Label id of a pixel that no detection covers; dictionary entries count from 1."""

MAX_LABELS = 65535
"""Label maps are uint16 images."""


@dataclass(frozen=True)
class DictionaryEntry:
    """One kind of thing in the scene.

    Attributes:
        label: the name shown to people.
        aliases: other names that were merged into this entry.
        pixels: how many pixels of all label maps carry it.
        views: in how many label maps it occurs.
    """

    label: str
    aliases: tuple[str, ...] = ()
    pixels: int = 0
    views: int = 0


@dataclass(frozen=True)
class Dictionary:
    """Entries in id order: entry i has label id i + 1."""

    entries: tuple[DictionaryEntry, ...]

    def __post_init__(self) -> None:
        if len(self.entries) > MAX_LABELS:
            raise InvalidInputError(f"{len(self.entries)} labels", field="labels", limit=f"{MAX_LABELS} labels")
        count = sum(1 + len(entry.aliases) for entry in self.entries)
        if len(self._ids) != count:
            raise InvalidInputError("two dictionary entries share a name", field="labels")

    @cached_property
    def _ids(self) -> dict[str, int]:
        return {
            label_key(name): index + 1
            for index, entry in enumerate(self.entries)
            for name in (entry.label, *entry.aliases)
        }

    def id_of(self, name: str) -> int | None:
        """Label id of `name` (case, plural and spelling variants count as the same), or None."""
        return self._ids.get(label_key(name))

    def label_of(self, label_id: int) -> str:
        """Name of a label id; 0 is "undetected"."""
        return "undetected" if label_id == UNDETECTED else self.entries[label_id - 1].label

    def __len__(self) -> int:
        return len(self.entries)


def dictionary_of(labels: Iterable[str]) -> Dictionary:
    """A dictionary of bare names, in order; variants of an earlier name are dropped."""
    seen: dict[str, str] = {}
    for label in labels:
        seen.setdefault(label_key(label), label)
    return Dictionary(tuple(DictionaryEntry(label) for label in seen.values()))


def label_key(name: str) -> str:
    """The hash-table key of a name: Unicode-folded, case-folded, separators unified, last word in the singular.

    Two names with one key are the same thing: "Coffee-Machines", "coffee machine" and "COFFEE_MACHINE".
    Scripts without case or plural pass through unchanged, so the key is never empty unless the name is.
    """
    text = unicodedata.normalize("NFKC", name).casefold()
    words = re.sub(r"[\s_\-/]+", " ", text).strip().split(" ")
    words[-1] = _singular(words[-1])
    return " ".join(words)


_IRREGULAR = {
    "people": "person", "men": "man", "women": "woman", "children": "child", "feet": "foot", "teeth": "tooth",
    "mice": "mouse", "geese": "goose", "knives": "knife", "leaves": "leaf", "shelves": "shelf", "loaves": "loaf",
    "scarves": "scarf", "wolves": "wolf", "halves": "half", "lives": "life", "wives": "wife",
    "buses": "bus", "gases": "gas", "lenses": "lens", "canvases": "canvas", "cacti": "cactus", "cactuses": "cactus",
    "cookies": "cookie", "brownies": "brownie", "hoodies": "hoodie", "smoothies": "smoothie", "movies": "movie",
    "pies": "pie", "ties": "tie", "neckties": "necktie", "selfies": "selfie", "calories": "calorie",
    "potatoes": "potato", "tomatoes": "tomato", "mangoes": "mango", "heroes": "hero", "dominoes": "domino",
    "volcanoes": "volcano", "mosquitoes": "mosquito", "buffaloes": "buffalo", "torpedoes": "torpedo",
}  # fmt: skip
_SINGULAR_S = frozenset(
    "scissors glasses sunglasses jeans pants trousers shorts headphones binoculars pliers tongs tweezers stairs "
    "bus gas glass lens canvas cactus compass chess iris news series species chassis atlas asparagus hummus".split()
)


def _singular(word: str) -> str:
    if word in _IRREGULAR:
        return _IRREGULAR[word]
    if not word.isascii() or len(word) < 4 or word in _SINGULAR_S or word.endswith(("ss", "us", "is")):
        return word
    if word.endswith("ies"):
        return word[:-3] + "y"
    if word.endswith(("sses", "shes", "ches", "xes", "zes")):
        return word[:-2]
    return word[:-1] if word.endswith("s") else word
