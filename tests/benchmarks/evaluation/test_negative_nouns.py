"""Nouns of objects that are not there are many, all different, and none that might be there."""

from __future__ import annotations

from benchmarks.evaluation.negative_nouns import negative_nouns
from fastsplat.service.common.dictionary import dictionary_of


def test_negative_nouns_are_many_different_and_name_nothing_that_is_there() -> None:
    nouns = negative_nouns()
    assert len(nouns) >= 150 and len(dictionary_of(nouns)) == len(nouns)
    left = negative_nouns(["Zebras", "toy car", "zebra crossing"])
    assert set(nouns) - set(left) == {"zebra", "race car"}
    table = ("table", "soda can", "cereal box", "frying pan", "utensil holder", "wall", "floor", "magnifying glass")
    assert len(negative_nouns(table)) >= 100
