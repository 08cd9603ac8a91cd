"""Label dictionary of a scene, a hash table (FAST-Splat, section 4)."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache

from fastsplat_contract.errors import InvalidInputError

UNDETECTED = 0  # label id of pixels without a detection; dictionary entries count from 1

MAX_LABELS = 65535  # label maps are uint16 images


@dataclass(frozen=True)
class DictionaryEntry:
    """A class of objects in the scene.

    Attributes:
        confidence: that objects with this label are of the class, 0..1. 1 for names from the capture or a person; for
            detected ones see `fastsplat.service.perception.label_maps.vocabulary.name_confidence`.
    """

    label: str
    aliases: tuple[str, ...] = ()  # names merged into this entry
    pixels: int = 0  # in all label maps
    views: int = 0  # label maps that contain it
    confidence: float = 1.0


@dataclass(frozen=True)
class Dictionary:
    """Entries in id order: entry i has label id i + 1.

    Raises:
        InvalidInputError: more than `MAX_LABELS` entries, duplicate names, or a confidence outside 0..1.
    """

    entries: tuple[DictionaryEntry, ...]

    def __post_init__(self) -> None:
        if len(self.entries) > MAX_LABELS:
            raise InvalidInputError(f"{len(self.entries)} labels", field="labels", limit=f"{MAX_LABELS} labels")
        if len(self._ids) != sum(1 + len(entry.aliases) for entry in self.entries):
            raise InvalidInputError("two dictionary entries share a name", field="labels")
        for entry in self.entries:
            if not 0.0 <= entry.confidence <= 1.0:
                raise InvalidInputError(
                    f"the label {entry.label[:80]!r} has a confidence of {entry.confidence}",
                    field="labels",
                    limit="0 to 1",
                )

    @cached_property
    def _ids(self) -> dict[str, int]:
        return {
            _folded(name): index + 1
            for index, entry in enumerate(self.entries)
            for name in (entry.label, *entry.aliases)
        }

    @cached_property
    def _ids_by_key(self) -> dict[str, int]:
        ids: dict[str, int] = {}
        for name, label_id in self._ids.items():
            ids.setdefault(label_key(name), label_id)
        return ids

    def id_of(self, name: str) -> int | None:
        """Returns the label id of a name, ignoring case, plural and spelling variants, or None.

        Exact names take precedence over `label_key`, so names survive changes of the plural rules. Of two entries with
        one key, the first gets its other forms.
        """
        label_id = self._ids.get(_folded(name))
        return self._ids_by_key.get(label_key(name)) if label_id is None else label_id

    def label_of(self, label_id: int) -> str:
        return "undetected" if label_id == UNDETECTED else self.entries[label_id - 1].label

    def __len__(self) -> int:
        return len(self.entries)


def dictionary_of(labels: Iterable[str]) -> Dictionary:
    """Builds a dictionary of bare names in order, dropping variants of earlier names."""
    by_key: dict[str, str] = {}
    for label in labels:
        by_key.setdefault(label_key(label), label)
    return Dictionary(tuple(DictionaryEntry(label) for label in by_key.values()))


def label_key(name: str) -> str:
    """Normalizes a name: Unicode and case folding, unified separators, last word singular.

    "Coffee-Machines", "coffee machine" and "COFFEE_MACHINE" have one key. Plurals are English; words of other alphabets
    stay unchanged. The key is empty only if the name is.
    """
    words = _folded(name).split(" ")
    if words[-1] == "glasses" and words[-2:-1] and words[-2] in _DRINKS:
        words[-1] = "glass"  # other glasses are spectacles
    else:
        words[-1] = _singular(words[-1])
    return " ".join(words)


def _folded(name: str) -> str:
    text = unicodedata.normalize("NFKC", name).casefold()
    return re.sub(r"[\s_\-/]+", " ", text).strip()


_DRINKS = frozenset("beer champagne cocktail drinking juice martini milk shot water whiskey whisky wine".split())

_ONE_FORM = frozenset(
    """acropolis aegis alias asbestos atlas bathos bias binoculars breeches britches cannabis canvas cercis
    chamois chaos chassis chrysalis cis clematis clippers clitoris clothes contretemps corps cosmos dais
    debris diabetes digitalis ephemeris epidermis epididymis ethos eyas gallows gas glasses glottis haggis
    headphones headquarters herpes hijinks his hubris ibis innings iris is jackanapes jeans lens mantis
    marquis measles metropolis mews mumps news pajamas pants pathos pelvis penis pincers pliers polis
    precis proboscis proceedings pyjamas rabies rhinoceros sassafras scissors series shears shorts siemens
    species stairs subspecies sunglasses tennis testes testis theirs thermos tongs trellis trousers
    tweezers undies yes""".split()
)
"""Nouns with one form, and singulars in -s that no ending identifies."""

_IN_E = frozenset(
    """abuse aloe annexe avalanche axe backache backhoe bellyache birdie bivalve blouse bookie brownie budgie
    cache caddie calorie canoe cause chartreuse clause cloche collie cookie cootie corpse creche crevasse
    demitasse doe earache excuse floe foe fuse genie goalie groupie grouse headache heartache hoe hoodie
    hypotenuse impasse junkie lassie lingerie magpie menagerie mistletoe mousse movie muse necktie newbie
    niche nightie oboe oldie onesie pastiche pause pickaxe pie pixie posse potpie prairie psyche quiche
    recluse rookie rotisserie salve selfie sloe smoothie softie spouse stomachache sweetie throe tie toe
    toothache tranche twelve use valve veggie vie weave woe zombie""".split()
)
"""Nouns in -e whose plural looks like that of a noun without it."""

_IRREGULAR = {
    "agenda": "agendum", "brethren": "brother", "candelabra": "candelabrum", "children": "child", "coptis": "copti",
    "criteria": "criterion", "dice": "die", "dies": "die", "emus": "emu", "hooves": "hoof", "kine": "cow",
    "lice": "louse", "menus": "menu", "monies": "money", "morgana": "morganon", "mouses": "mouse", "opera": "opus",
    "oxen": "ox", "peoples": "person", "petrocoptis": "petrocopti", "phenomena": "phenomenon", "roma": "rom",
    "taxis": "taxi", "themselves": "itself", "thieves": "thief",
}  # fmt: skip

_ENDINGS = tuple(
    (re.compile(f"{ending}$"), singular)
    for ending, singular in (
        ("men", "man"),
        ("people", "person"),
        ("geese", "goose"),
        ("teeth", "tooth"),
        ("feet", "foot"),
        ("mice", "mouse"),
        ("zoa", "zoon"),
        ("bacteria", "bacterium"),
        ("(ov|dat|errat|strat)a", r"\1um"),
        ("(alga|vertebra|persona|alumna|vita)e", r"\1"),
        ("(cact|nucle|loc|alumn|bacill|sarcophag|stimul)i", r"\1us"),
        ("(ss|us|ceps|sis|xis|itis|ois|[^o]cis)", r"\1"),
        ("(aly|the|cri|oa|gno|neuro|psycho)ses", r"\1sis"),
        ("([aeo]l|ar|oa|(?<!d)ea)ves", r"\1f"),
        ("([nw]|(?<!o)l)ives", r"\1ife"),
        ("(house|shoe)s", r"\1"),
        ("(ss|us|ceps|itis|x|ch|sh|o|zz)es", r"\1"),
        ("ies", "y"),
        ("s", ""),
    )
)
"""Plural endings, and singular endings in -s, with their singulars; the first match counts."""

_MIN_LETTERS = 3


@lru_cache(1 << 16)
def _singular(word: str) -> str:
    """Returns the singular of a folded English noun; idempotent."""
    forms = [word]
    while (singular := _singular_once(forms[-1])) not in forms:
        forms.append(singular)
    return min(forms[forms.index(singular) :])  # one word, unless the rules cycle on made-up words


def _singular_once(word: str) -> str:
    if word in _IRREGULAR:
        return _IRREGULAR[word]
    if not (word.isascii() and word.isalpha()) or len(word) < _MIN_LETTERS or word in _ONE_FORM:
        return word
    if word[:-1] in _IN_E and word.endswith("s"):
        return word[:-1]
    if word.endswith("es") and word[:-2] in _ONE_FORM:
        return word[:-2]
    for ending, singular in _ENDINGS:
        changed, count = ending.subn(singular, word)
        if count:
            return changed
    return word
