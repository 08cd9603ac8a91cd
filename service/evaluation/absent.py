"""Queries for things that are not there: lists of nouns of our own, each checked against the scene's labels."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Literal

from fastsplat.service.common.dictionary import label_key

AbsentList = Literal["nouns", "household"]
"""`nouns`: things that fit on no table and in no kitchen. `household`: things that might well be there, for scenes
whose truth names everything in them."""


def absent_nouns(labels: Iterable[str], which: AbsentList = "nouns") -> tuple[str, ...]:
    """The nouns of a list that name nothing among `labels`.

    A noun is dropped when it shares a word with a label ("race car" where there is a "toy car"): it might be there.
    """
    words = {word for label in labels for word in label_key(label).split()}
    return tuple(noun for noun in _nouns(which) if not words & set(label_key(noun).split()))


@cache
def _nouns(which: AbsentList) -> tuple[str, ...]:
    file = Path(__file__).with_name(f"absent_{which}.txt")
    return tuple(line.strip() for line in file.read_text(encoding="utf-8").splitlines() if line.strip())
