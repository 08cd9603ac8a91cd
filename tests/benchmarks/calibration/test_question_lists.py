"""The lists that judge answers hold nothing that fits them."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from benchmarks.absence.questions import (
    ABSENT,
    COMPOUNDS,
    FITTED,
    PRESENT,
    calibrating_keys,
    content_words,
    doubles,
    read_cases,
    said_alike,
)
from benchmarks.calibration.folds import folds_of, twin_groups
from benchmarks.calibration.lists import read_scenes
from benchmarks.evaluation.negative_nouns import negative_nouns
from fastsplat.service.common.dictionary import dictionary_of, label_key


def test_negative_nouns_are_many_different_and_name_nothing_that_is_there() -> None:
    nouns = negative_nouns()
    assert len(nouns) >= 150 and len(dictionary_of(nouns)) == len(nouns)
    left = negative_nouns(["Zebras", "toy car", "zebra crossing"])
    assert set(nouns) - set(left) == {"zebra", "race car"}


def test_no_scene_has_a_name_twice() -> None:
    for scene in read_scenes():
        assert len(dictionary_of(scene.labels)) == len(scene.labels)


def test_no_question_stands_in_two_lists() -> None:
    cases = read_cases()
    assert not list(doubles(cases))
    assert len(cases) >= 600 and len({case.scene for case in cases}) >= 12
    counts = Counter((case.scene, case.list) for case in cases)
    assert all(counts[scene, kind] >= 5 for scene in {case.scene for case in cases} for kind in PRESENT + ABSENT)


def test_compounds_calibrate_and_end_in_a_name() -> None:
    cases = read_cases(COMPOUNDS)
    assert {label_key(case.question) for case in cases} <= calibrating_keys()
    for case in cases:
        if case.list == "compound":
            assert label_key(case.question).split(" ")[-1] == label_key(case.answers[0]).split(" ")[-1], case.question
    assert not {case.list for case in read_cases()} & {"compound", "feigned", "other", "sibling", "standin"}


def test_the_proof_finds_every_kind_of_double() -> None:
    cases = read_cases()
    fitted = read_cases(FITTED)[0]
    assert len(list(doubles([cases[0], cases[0]]))) == 1
    assert "calibrates" in next(doubles([fitted]))
    of_five = next(case for case in read_cases(FITTED) if len(content_words(case.question)) > 3)
    assert list(doubles([replace(fitted, question=f"{of_five.question} quietly")]))
    assert not said_alike(content_words("soap dish"), content_words("dish soap"))
    labels, here, gone = ("red cup", "pan"), ("red cup",), tuple[str, ...]()
    named = type(cases[0])
    assert list(doubles([named("x", labels, "use", "drink from the red cup", here)]))
    assert list(doubles([named("x", labels, "near", "pan", gone)]))
    assert not list(doubles([named("x", labels, "near", "pan flute of gold", gone)]))


def test_dictionaries_that_share_labels_are_in_one_fold() -> None:
    """Also by way of a third; and every fold has some."""
    chain = [("cup", "pan", "fork"), ("pan", "fork", "lamp", "bed"), ("bed", "lamp", "rug"), ("owl", "oak", "elm")]
    assert twin_groups(chain) == [0, 0, 0, 3]
    scenes = [scene.labels for scene in read_scenes()]
    folds, groups = folds_of(scenes, 4), twin_groups(scenes)
    assert len(set(zip(groups, folds, strict=True))) == len(set(groups)) and set(folds) == {0, 1, 2, 3}
    assert max(Counter(folds).values()) - min(Counter(folds).values()) <= 2
