"""What the words of a question say of a dictionary: a name inside another phrase is not that phrase."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry, dictionary_of
from fastsplat.service.query.language.words.name_matching import NameIndex, NameMatch
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from tests.query.conftest import PLAIN, DrawnEncoder, make_scene

LABELS = (
    *("mug", "red scissors", "wall", "orange", "table", "lamp", "glass", "picture", "kettle", "lid", "man", "hat"),
    *("coffee machine", "dog", "chair", "spoon", "fork", "magnifying glass", "can of paint", "blue box", "red box"),
)


def named(match: NameMatch) -> dict[str, list[str]]:
    """The parts of a match that say anything, by label."""
    parts = {"exact": match.exact, "heads": match.heads, "hyponyms": match.hyponyms, "negated": match.negated}
    return {part: [LABELS[label_id - 1] for label_id in ids] for part, ids in parts.items() if ids}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        # The whole phrase is a name.
        ("the mugs", {"exact": ["mug"]}),
        ("Where are my Coffee-Machines?", {"exact": ["coffee machine"]}),
        ("can of paint", {"exact": ["can of paint"]}),
        # It asks for more than the name says, but not for another class: the dictionary knows no color, size or number.
        ("the two big mugs", {"exact": ["mug"]}),
        ("a light blue kettle", {"exact": ["kettle"]}),
        ("big red box", {"exact": ["red box"]}),
        # What the name says more is a kind of what is asked for.
        ("scissors", {"exact": ["red scissors"]}),
        ("a box", {"exact": ["blue box", "red box"]}),
        # The name says something else.
        ("blue scissors", {"heads": ["red scissors"]}),
        # The name is the head, and the question says more of it.
        ("glass of water", {"heads": ["glass"], "hyponyms": ["magnifying glass"]}),
        ("man wearing a hat", {"heads": ["man"]}),
        ("a kettle without the lids on the table", {"heads": ["kettle"], "negated": ["lid"]}),
        ("the red mug on the table", {"heads": ["mug"]}),
        ("mug, not the glass", {"heads": ["mug"], "negated": ["glass"]}),
        ("fork and spoon", {"heads": ["fork", "spoon"]}),
        # The name ends in the head: a kind of it, as far as words tell.
        ("machine", {"hyponyms": ["coffee machine"]}),
        ("can", {"hyponyms": ["can of paint"]}),
        # The name is only mentioned.
        ("wall clock", {}),
        ("handle of the lid", {}),
        ("what is on the table?", {}),
        ("room without a chair", {"negated": ["chair"]}),
        ("no chair", {"negated": ["chair"]}),
        # What is made of something may be something else, and so may what is hot.
        ("wooden dog", {}),
        ("hot dog", {}),
    ],
)
def test_what_a_question_names(text: str, expected: dict[str, list[str]]) -> None:
    assert named(NameIndex(dictionary_of(LABELS)).match(text)) == expected


@pytest.mark.parametrize(
    ("text", "mentions"),
    [
        ("wall clock", {"wall": "clock"}),
        ("orange juice", {"orange": "juice"}),
        ("orange traffic cones", {"orange": "traffic cone"}),
        ("table lamp", {"table": "lamp"}),
        ("picture of a dog", {"dog": "picture"}),
        ("man with a hat", {"hat": "man"}),
        ("mug on the table by the wall", {"table": "mug", "wall": "mug"}),
        ("bag for the kettle", {"kettle": "bag"}),
        ("handle of the lid", {}),  # showing the lid would be an answer
        ("mug", {}),
        ("mug next to a mug", {}),
        ("on the table", {}),
    ],
)
def test_what_a_question_only_mentions(text: str, mentions: dict[str, str]) -> None:
    match = NameIndex(dictionary_of(LABELS)).match(text)
    assert {LABELS[label_id - 1]: words for label_id, words in match.mentions.items()} == mentions


def test_a_longer_name_wins_over_its_head() -> None:
    names = NameIndex(dictionary_of(["mug", "red mug", "picture", "picture of a dog"]))
    assert [names.match(text).exact for text in ("mug", "red mug", "a picture of a dog")] == [(1,), (2,), (4,)]


def test_aliases_are_names() -> None:
    names = NameIndex(Dictionary((DictionaryEntry("mug", ("big cup", "tumbler")), DictionaryEntry("jar"))))
    assert names.match("the red tumblers").exact == names.match("cup").exact == (1,)


@pytest.fixture
def ask() -> Callable[[str], Any]:
    """Answers of an encoder that finds every phrase as near as can be to every name it mentions."""
    leaning = {label: [0.0] * row + [1.0] for row, label in enumerate(LABELS[:15])}
    leaning |= {
        "glass of water": leaning["glass"],
        "picture of a dog": leaning["dog"],
        "kettle without a lid": leaning["lid"],
        "man with a hat": leaning["hat"],
        "wall clock": leaning["wall"],
        "orange juice": leaning["orange"],
        "table lamp": leaning["table"],
        "old scissors": leaning["red scissors"],
    }
    index = SceneIndex(make_scene(LABELS[:15]), DrawnEncoder(leaning), PLAIN)
    return lambda text: index.ask([text])[0]


@pytest.mark.parametrize(
    ("text", "outcome", "first"),
    [
        ("glass of water", "cannot_say", "glass"), ("picture of a dog", "cannot_say", "picture"),
        ("kettle without a lid", "cannot_say", "kettle"), ("man with a hat", "cannot_say", "man"),
        ("old scissors", "probably_here", "red scissors"), ("machine", "here", "coffee machine"),
        ("old mug", "here", "mug"), ("scissors", "here", "red scissors"), ("the mugs", "here", "mug"),
        ("coffee machine", "here", "coffee machine"), ("wall clock", "not_here", None),
        ("orange juice", "cannot_say", None), ("table lamp", "not_here", None),
    ],
)  # fmt: skip
def test_answers_follow_the_grammar_whatever_the_encoder_says(
    ask: Callable[[str], Any], text: str, outcome: str, first: str | None
) -> None:
    answer = ask(text)
    assert answer.outcome == outcome
    if first is not None:
        assert answer.matches[0].label == first and answer.matches[0].relevant
    else:
        assert not answer.relevant_ids
    denied = {"lid"} if "without" in text else set()
    assert not denied & {match.label for match in answer.matches if match.relevant}


def test_what_was_not_checked_is_said(ask: Callable[[str], Any]) -> None:
    assert ask("man with a hat").sentence.endswith('nothing here measures "with a hat"; it may be "man".')
    assert ask("old broken mug").sentence == 'Here: "mug"; "old broken" was not checked.'


@pytest.mark.parametrize(
    ("text", "sure"), [("mug", True), ("the old mug", True), ("glass of water", False), ("wall clock", False)]
)
def test_only_a_name_is_certain(calibrated_encoder: Any, text: str, sure: bool) -> None:
    """With one label, the calibrated figures of a phrase that contains its name stay below certainty."""
    for label in LABELS[:8]:
        (answer,) = SceneIndex(make_scene([label], code=2), calibrated_encoder, QuerySettings()).ask([text])
        certain = answer.probability == 1.0 and not answer.is_absent
        assert certain == (sure and label == "mug")


def test_a_confidence_below_one_is_in_every_probability_of_its_entry(calibrated_encoder: Any) -> None:
    scene = make_scene(("mug", "boat", "kettle"), code=2)
    doubted = (DictionaryEntry("mug"), DictionaryEntry("boat", views=1, confidence=0.3), DictionaryEntry("kettle"))
    texts = ["boat", "the old boat", "mug", "quark"]
    sure, unsure = (
        SceneIndex(variant, calibrated_encoder, QuerySettings())
        for variant in (scene, replace(scene, dictionary=Dictionary(doubted)))
    )
    for before, after in zip(sure.ask(texts), unsure.ask(texts), strict=True):
        doubted_name = "boat" in before.text
        assert before.relevant_ids == after.relevant_ids
        assert after.outcome == ("probably_here" if doubted_name else before.outcome)
        old = {match.label: match.probability for match in before.matches}
        new = {match.label: match.probability for match in after.matches}
        assert new == pytest.approx({"mug": old["mug"], "boat": 0.3 * old["boat"], "kettle": old["kettle"]})
        assert after.presence >= max(new.values())
        if "boat" in before.text:
            assert before.probability == before.presence == 1.0 and before.label_set == (2,)
            assert after.probability == pytest.approx(0.3) == after.presence
            assert after.label_set == (2, 0)  # nine times in ten is not promised of a name that is right in three
            assert "(30 %)" in after.sentence
        elif before.text == "mug":
            assert after.probability == 1.0 and after.label_set == (1,)
