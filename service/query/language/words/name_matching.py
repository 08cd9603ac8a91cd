"""Matches a question with dictionary names: as asked for, as a kind, or as mentioned."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field

from fastsplat.service.common.dictionary import Dictionary, label_key
from fastsplat.service.query.language.words.noun_phrases import NounPhrase, parse_noun_phrase, split_modifiers

_MAX_SPAN = 6


@dataclass(frozen=True)
class NameMatch:
    """Entries named in a question, without comparing embeddings.

    Attributes:
        exact: label ids that are exactly what is asked for.
        heads: label ids of what is asked for with more than a dictionary can tell ("man with a hat"), or something else
            ("blue scissors" for the entry "red scissors").
        hyponyms: label ids of names that end in what is asked for: "coffee machine" for "machine".
        mentions: entries that are mentioned but not asked for, by label id, with the head's remaining words: "clock"
            for wall in "wall clock", "man" for hat in "man with a hat".
        bases: by label id, the number of last words that are its name, after other words: 1 for chair in "wicker
            chair". No name tells if that is a chair.
    """

    exact: tuple[int, ...] = ()
    heads: tuple[int, ...] = ()
    hyponyms: tuple[int, ...] = ()
    mentions: dict[int, str] = field(default_factory=dict)
    negated: tuple[int, ...] = ()  # label ids that the question denies: lid in "kettle without a lid"
    unchecked: str = ""  # words of the question that no entry answers for: "red", "with a hat"; "" without
    bases: dict[int, int] = field(default_factory=dict)


@dataclass(frozen=True)
class _Group:
    label_id: int
    modifiers: frozenset[str]


class NameIndex:
    """Dictionary names indexed by their heads; thread-safe."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._dictionary = dictionary
        self._by_head: defaultdict[str, list[_Group]] = defaultdict(list)
        self._hyponyms: defaultdict[str, list[int]] = defaultdict(list)
        for label_id, entry in enumerate(dictionary.entries, start=1):
            for name in (entry.label, *entry.aliases):
                self._add(label_id, name)

    def _add(self, label_id: int, name: str) -> None:
        phrase = parse_noun_phrase(name)
        if len(phrase.heads) != 1:
            return
        modifiers, head = split_modifiers(phrase.heads[0])
        words = head.split(" ")
        if not phrase.details:
            self._by_head[head].append(_Group(label_id, modifiers))
        for start in range(1 if not phrase.details else 0, len(words)):
            self._hyponyms[" ".join(words[start:])].append(label_id)

    def has(self, text: str) -> bool:
        """True if the whole text is a name of the dictionary."""
        return self._dictionary.id_of(text) is not None

    def match(self, text: str) -> NameMatch:
        """Matches a text with the dictionary.

        It is exact if (1) the whole of it, without question words and articles, is a name; (2) a name adds plain
        modifiers to it: "scissors" matches "red scissors"; (3) it adds plain modifiers to a name, and no name has them:
        "red mug" matches "mug", as names are of classes and say nothing of color, size or number. Any other addition
        may change the object, and is never exact."""
        phrase = parse_noun_phrase(text)
        for name in (text, phrase.text):
            label_id = self._dictionary.id_of(name)
            if label_id is not None:
                return NameMatch(exact=(label_id,))
        if len(phrase.heads) == 1 and not phrase.details:
            exact, unchecked = self._exact(phrase.heads[0])
            if exact:
                return NameMatch(exact=exact, unchecked=unchecked)
        negated = {label_id for detail in phrase.details if detail.negated for label_id in self._named(detail.groups)}
        heads, hyponyms = [], []
        for group in phrase.heads:
            _, head = split_modifiers(group)
            heads += [entry.label_id for entry in self._by_head.get(head, []) if entry.label_id not in negated]
            hyponyms += [label_id for label_id in self._hyponyms.get(head, []) if label_id not in negated]
        return NameMatch(
            heads=tuple(dict.fromkeys(heads)),
            hyponyms=tuple(dict.fromkeys(hyponyms)),
            mentions=self._mentions(phrase, {*heads, *hyponyms}),
            negated=tuple(sorted(negated)),
            unchecked=phrase.tail if heads else "",
            bases=self._bases(phrase),
        )

    def _exact(self, group: str) -> tuple[tuple[int, ...], str]:
        """Cases (2) and (3) of `match`: label ids, and the modifiers that no name has."""
        modifiers, head = split_modifiers(group)
        same = self._by_head.get(head, [])
        if kinds := {entry.label_id for entry in same if entry.modifiers >= modifiers}:
            return tuple(sorted(kinds)), ""
        general = [entry for entry in same if entry.modifiers < modifiers]
        shared = max((len(entry.modifiers) for entry in general), default=0)
        nearest = [entry for entry in general if len(entry.modifiers) == shared]
        missing = modifiers - frozenset[str]().union(*(entry.modifiers for entry in nearest))
        unchecked = " ".join(word for word in label_key(group).split(" ") if word in missing) if nearest else ""
        return tuple(sorted({entry.label_id for entry in nearest})), unchecked

    def _bases(self, phrase: NounPhrase) -> dict[int, int]:
        """Entries whose names are the longest end of the question's head, with their word counts."""
        if len(phrase.heads) != 1:
            return {}
        modifiers, head = split_modifiers(phrase.heads[0])
        words = head.split(" ")
        for start in range(1, len(words)):
            named = [
                entry.label_id
                for entry in self._by_head.get(" ".join(words[start:]), [])
                if entry.modifiers <= modifiers or modifiers <= entry.modifiers
            ]
            if named:
                return dict.fromkeys(named, len(words) - start)
        return {}

    def _named(self, groups: tuple[str, ...]) -> Iterator[int]:
        """Yields label ids that these noun groups name, and of kinds of them."""
        for group in groups:
            label_id = self._dictionary.id_of(group)
            modifiers, head = split_modifiers(group)
            yield from () if label_id is None else (label_id,)
            yield from (entry.label_id for entry in self._by_head.get(head, []) if entry.modifiers >= modifiers)

    def _mentions(self, phrase: NounPhrase, heads: set[int]) -> dict[int, str]:
        mentions: dict[int, str] = {}
        core = label_key(phrase.heads[0]).split(" ") if len(phrase.heads) == 1 else []
        for label_id, start, end in self._spans(core):
            if end < len(core):
                mentions.setdefault(label_id, " ".join(core[:start] + core[end:]))
        rest = " and ".join(phrase.heads)
        for detail in phrase.details if rest else ():
            # "The handle of the door" is part of the door: showing the door is an answer, if there is no better one.
            if detail.connector != "of" or heads:
                for group in detail.groups:
                    for label_id, *_ in self._spans(label_key(group).split(" ")):
                        mentions.setdefault(label_id, rest)
        for label_id in heads:
            mentions.pop(label_id, None)
        return mentions

    def _spans(self, words: list[str]) -> Iterator[tuple[int, int, int]]:
        """Yields label ids named by consecutive words, with start and end."""
        for start in range(len(words)):
            for end in range(start + 1, min(start + _MAX_SPAN, len(words)) + 1):
                label_id = self._dictionary.id_of(" ".join(words[start:end]))
                if label_id is not None:
                    yield label_id, start, end
