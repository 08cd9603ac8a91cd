"""The list of common objects: its form, and what it says of a question and labels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.language.meaning.common_objects import (
    COLUMNS,
    FILE,
    KnownLabels,
    are_other_objects,
    common_objects,
)
from fastsplat.service.query.language.meaning.embeddings import TextCache
from fastsplat.service.query.query_settings import QuerySettings
from tests.query.conftest import DrawnEncoder

_LINES = FILE.read_text("ascii").splitlines()
_LABELS = ("couch", "frying pan", "red mug", "xyzzy", "chair", "hammer")


def _columns(encoder: DrawnEncoder, question: str, labels: Sequence[str] = _LABELS) -> dict[str, np.ndarray]:
    cache = TextCache(encoder, QuerySettings().templates, 999)
    embedded = cache.embed([question])
    similarity = (cache.embed(labels) @ embedded[0]).astype(np.float64)
    found = KnownLabels([(label,) for label in labels], cache).compare(question, embedded[0], similarity)
    assert found.shape == (len(labels), len(COLUMNS)) and np.isfinite(found).all()
    return {"similarity": similarity} | dict(zip(COLUMNS, found.T, strict=True))


def test_every_line_is_as_it_is_read() -> None:
    """Names and kinds are compared as `label_key` has them, and that takes too long to be done with 10,000 of them."""
    assert sorted(_LINES, key=lambda line: line.split(" | ")[0]) == _LINES
    for line in _LINES:
        name, aliases, kinds, uses = (part.strip() for part in line.split("|"))
        names = [name, *(alias.strip() for alias in aliases.split(",") if alias)]
        for key in [*names, *(kind.strip() for kind in kinds.split(","))]:
            assert key and key == label_key(key), line
        assert len(set(names)) == len(names) and all(use.strip() for use in uses.split(";")), line


@given(line=st.sampled_from(_LINES))
def test_each_name_of_an_object_finds_the_same(line: str) -> None:
    name, aliases, *_ = line.split(" | ")
    objects = [set(common_objects(word.strip())[0]) for word in (name, *aliases.split(",")) if word.strip()]
    assert set[object]().union(*objects) and set.intersection(*objects)
    upper, whole = common_objects(name.upper().replace(" ", "_"))
    assert whole and set(upper) == objects[0]


def test_a_longer_name_is_known_by_its_end() -> None:
    objects, whole = common_objects("very old frying pan")
    assert not whole and objects == common_objects("frying pan")[0]
    assert common_objects("xyzzy") == ((), False)


def test_other_names_kinds_and_their_opposites(calibrated_encoder: DrawnEncoder) -> None:
    def rows(question: str, column: str) -> set[str]:
        values = _columns(calibrated_encoder, question)[column]
        return {label for label, value in zip(_LABELS, values, strict=True) if value > 0}

    assert rows("skillet", "known_as") == {"frying pan"}
    assert rows("skillets", "known_as") == {"frying pan"}
    assert rows("xyzzy", "known_as") == {"xyzzy"}
    assert rows("cookware", "known_kind") == {"frying pan"} and rows("cookware", "known_as") == set()
    assert rows("armchair", "known_below") == {"chair"}
    assert rows("mallet", "uses_shared") == {"hammer"}
    assert "frying pan" in rows("saucepan", "kinds_shared") and "hammer" not in rows("saucepan", "kinds_shared")


def test_what_is_not_known_stands_behind_the_name(calibrated_encoder: DrawnEncoder) -> None:
    found = _columns(calibrated_encoder, "something to sit on")
    row = _LABELS.index("xyzzy")
    assert found["named"][row] == found["similarity"][row]
    assert 0 < abs(found["use"][row]) < abs(found["similarity"][row])
    assert found["label_known"].tolist() == [1.0, 1.0, 0.5, 0.0, 1.0, 1.0]
    assert (found["named"] >= found["similarity"]).all()


def test_no_labels_are_no_rows(calibrated_encoder: DrawnEncoder) -> None:
    known = KnownLabels([], TextCache(calibrated_encoder, QuerySettings().templates, 9))
    question = np.zeros(8, dtype=np.float32)
    assert known.compare("mug", question, np.zeros(0)).shape == (0, len(COLUMNS))


@pytest.mark.parametrize(
    ("word", "label"),
    [
        *(("chair", "dining table"), ("sofa", "dining table"), ("bookcase", "stool"), ("desk", "armchair")),
        *(("sofa", "teddy bear"), ("umbrella", "vase"), ("toilet", "bowl")),  # of no common kind
    ],
)
def test_two_objects_of_the_list_are_other_objects_both_ways(word: str, label: str) -> None:
    assert are_other_objects(word, [label]) and are_other_objects(label, [word])


@pytest.mark.parametrize(
    ("word", "label"),
    [
        *(("chair", "chair"), ("couch", "sofa"), ("kitchen table", "dining table")),  # one object by two names
        *(
            ("furniture", "dining table"),
            ("table", "dining table"),
            ("fruit", "banana"),
        ),  # a kind of what was asked for
        ("fork", "spoon"),  # of the same kinds
        *(("coffee", "cup"), ("tea", "coffee machine"), ("water", "bottle")),  # what it is for
        *(("xyzzy", "dining table"), ("chair", "xyzzy"), ("very old chair", "dining table")),  # not in the list
    ],
)
def test_nothing_else_is_said_to_be_another_object(word: str, label: str) -> None:
    assert not are_other_objects(word, [label])


@given(line=st.sampled_from(_LINES))
def test_no_object_is_another_than_itself_or_its_kind(line: str) -> None:
    name, aliases, kinds, _ = (part.strip() for part in line.split("|"))
    for word in (*aliases.split(","), *kinds.split(",")):
        assert not word or not are_other_objects(word.strip(), [name])
