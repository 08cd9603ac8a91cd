"""Nouns of objects that fit on no table and in no kitchen, for questions to which the answer is no."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from fastsplat.service.common.dictionary import label_key


def negative_nouns(labels: Iterable[str] = ()) -> tuple[str, ...]:
    """The nouns that name nothing among `labels`.

    A noun is dropped when it shares a word with a label ("race car" where there is a "toy car"): it might be there.
    """
    words = {word for label in labels for word in label_key(label).split()}
    nouns = Path(__file__).with_suffix(".txt").read_text(encoding="utf-8").split("\n")
    return tuple(noun.strip() for noun in nouns if noun.strip() and not words & set(label_key(noun).split()))
