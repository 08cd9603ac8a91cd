"""The lists that judge answers hold nothing that fits them."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from benchmarks.absence.questions import ABSENT, COMPOUNDS, FITTED, PRESENT, calibrating_keys, doubles, read_cases
from fastsplat.service.common.dictionary import label_key


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
    labels, here, gone = ("red cup", "pan"), ("red cup",), tuple[str, ...]()
    named = type(cases[0])
    assert list(doubles([named("x", labels, "use", "drink from the red cup", here)]))
    assert list(doubles([named("x", labels, "near", "pan", gone)]))
    assert not list(doubles([named("x", labels, "near", "pan flute of gold", gone)]))


@pytest.mark.parametrize("line", ["kind: a thing -> spoon", "another: a thing"])
def test_a_bad_line_is_named(line: str, tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_text(f"[room] cup\n{line}\n")
    with pytest.raises(ValueError, match="line 2"):
        read_cases(tmp_path / "list.txt")
