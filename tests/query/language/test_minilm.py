"""The paper's disambiguations, with the real default encoder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.query.language.meaning.calibration import calibration_for
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.messages.queries import Answer
from tests.query.conftest import make_scene

# Dictionaries of the scenes in FAST-Splat's figures 1 and 2 and its appendix on disambiguation.
KITCHEN = ("kettle", "coffee machine", "sink", "cabinet", "countertop", "wall", "bottle", "knife", "spoon")
LIVING_ROOM = ("couch", "chair", "vase", "tvmonitor", "pottedplant", "diningtable")
TABLETOP = (
    *("table", "floor", "wall", "utensil holder", "screwdriver", "red scissors", "can opener", "magnifying glass"),
    *("headset", "frying pan", "ramekin", "banana", "mug", "orange", "cereal box", "soda can", "bread"),
)
FRUIT_TABLE = ("apple", "pottedplant", "vase", "chair", "bowl")
ABSENT = ("dinosaur", "umbrella", "bicycle", "trombone", "submarine", "giraffe")

Ask = Callable[..., Answer]


@pytest.fixture
def ask(minilm: TextEncoder) -> Ask:
    def ask(labels: Sequence[str], text: str, **settings: Any) -> Answer:
        index = SceneIndex(make_scene(labels, code=2), minilm, QuerySettings(**settings))
        (answer,) = index.ask([text])
        return answer

    return ask


def relevant(answer: Answer) -> list[str]:
    return [match.label for match in answer.matches if match.relevant]


def without(labels: Sequence[str], *gone: str) -> list[str]:
    return [label for label in labels if label not in gone]


@pytest.mark.parametrize(
    ("labels", "text", "first"),
    [
        (KITCHEN, "coffee", "coffee machine"),
        (KITCHEN, "tea", "kettle"),
        (without(KITCHEN, "kettle", "spoon"), "tea", "coffee machine"),
        (KITCHEN, "cooking pot", "kettle"),
        (KITCHEN, "fork", "spoon"),
        (KITCHEN, "water", "bottle"),
        (FRUIT_TABLE, "fruit", "apple"),
    ],
)
def test_the_papers_disambiguations(ask: Ask, labels: Sequence[str], text: str, first: str) -> None:
    answer = ask(labels, text)
    assert answer.relation in ("kind_of", "related")
    assert answer.matches[0].label == first == relevant(answer)[0]
    assert (
        answer.sentence.startswith(("Perhaps here (", "Probably here (", "Here ("))
        and f'): "{first}", ' in answer.sentence
    )
    assert answer.probability == answer.matches[0].probability
    assert answer.coverage == 0.9 and answer.matches[0].label_id in answer.label_set


def test_a_fork_is_a_spoon_before_it_is_a_knife(ask: Ask) -> None:
    assert relevant(ask(KITCHEN, "fork")) == ["spoon", "knife"]
    assert relevant(ask((*KITCHEN, "cooking spoon"), "fork"))[:2] == ["spoon", "knife"]


@pytest.mark.parametrize(
    ("labels", "text", "first"),
    [
        (("glass", "bottle", "table"), "glass of water", "glass"),
        (("picture", "dog", "wall"), "picture of a dog", "picture"),
        (("kettle", "lid", "table"), "kettle without a lid", "kettle"),
        (("man", "hat", "table"), "man with a hat", "man"),
        ((*KITCHEN, "table"), "a SPOON on the countertop", "spoon"),
        (("mug", "table"), "the mug on the table", "mug"),
        (("lamp", "table"), "table lamp", "lamp"),
        (("red scissors", "knife"), "old scissors", "red scissors"),
    ],
)
def test_a_name_inside_another_phrase_leads_and_is_not_certain(
    ask: Ask, labels: Sequence[str], text: str, first: str
) -> None:
    answer = ask(labels, text)
    assert (answer.probability or 0) < 1
    if answer.outcome == "cannot_say":  # nothing measures what it says of the name
        assert relevant(answer) in ([first], []) and answer.phrase is not None and answer.phrase.refusal is not None
    else:
        assert relevant(answer)[0] == first
        assert answer.relation != "same" and answer.probability == answer.matches[0].probability


def test_what_a_question_denies_is_never_shown(ask: Ask) -> None:
    for labels in (("kettle", "lid"), ("lid", "pot"), ("lid",)):
        for text in ("kettle without a lid", "a kettle but not the lids", "no lid"):
            answer = ask(labels, text)
            assert "lid" not in relevant(answer)
            assert {match.label: match.probability for match in answer.matches}["lid"] < 1e-3


def test_a_kind_of_what_is_asked_for_is_not_called_absent(ask: Ask) -> None:
    answer = ask(TABLETOP, "scissors")
    assert answer.outcome == "here" and relevant(answer) == ["red scissors"] and answer.probability == 1
    assert answer.sentence.startswith('Here: "red scissors"')
    for text, kind in (("opener", "can opener"), ("holder", "utensil holder"), ("pan", "frying pan")):
        assert kind in relevant(ask(TABLETOP, text))


@pytest.mark.parametrize("labels", [KITCHEN, LIVING_ROOM, FRUIT_TABLE], ids=["kitchen", "living room", "fruit table"])
def test_most_absent_objects_are_absent(ask: Ask, labels: Sequence[str]) -> None:
    answers = [ask(labels, text) for text in ABSENT]
    assert sum(answer.is_absent for answer in answers) >= len(ABSENT) - 1
    assert "same" not in [answer.relation for answer in answers]


@pytest.mark.parametrize("text", ["🧸", "茶壶", "чайник", "إبريق الشاي", "x" * 1000, "object"])
def test_unusual_texts_get_an_answer(ask: Ask, text: str) -> None:
    answer = ask(KITCHEN, text)
    assert answer.relation != "same" and len(answer.matches) == len(KITCHEN)


def test_negatives_templates_and_coverage_are_the_questions_own(minilm: TextEncoder) -> None:
    index = SceneIndex(make_scene(KITCHEN, code=2), minilm, QuerySettings())
    (usual,) = index.ask(["fork"])
    (against,) = index.ask(["fork"], negatives=["cutlery"])
    assert against.matches[0].nearest_negative == "cutlery"
    assert against.matches[0].relevancy < usual.matches[0].relevancy
    # Likeness to negatives decides nothing by the default score, so that what was calibrated still holds.
    assert [match.probability for match in against.matches] == [match.probability for match in usual.matches]
    (bare,) = index.ask(["fork"], templates=["{}"])
    assert bare.probability is None and bare.coverage is None and bare.label_set == ()
    assert "not calibrated" in (bare.sentence)
    assert index.ask(["fork"], templates=QuerySettings().templates)[0] == usual
    sets = [index.ask(["fork"], coverage=coverage)[0].label_set for coverage in (1e-9, 0.5, 0.8, 0.9, 0.95, 1 - 1e-9)]
    assert [len(chosen) for chosen in sets] == sorted(len(chosen) for chosen in sets)
    assert len(sets[0]) == 1 and sorted(sets[-1]) == list(range(len(KITCHEN) + 1))
    assert index.ask(["fork"])[0] == usual


def test_the_temperature_is_the_encoders_own_unless_set(ask: Ask) -> None:
    usual, lerf = ask(KITCHEN, "fork"), ask(KITCHEN, "fork", temperature=10.0)

    def logit(relevancy: float) -> float:
        return float(np.log(relevancy / (1 - relevancy)))

    ratios = [logit(a.relevancy) / logit(b.relevancy) for a, b in zip(usual.matches, lerf.matches, strict=True)]
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-6)
    assert 1.5 < ratios[0] < 3.5  # MiniLM's cosines lie closer together than those of LERF's CLIP
    assert [match.probability for match in usual.matches] == [match.probability for match in lerf.matches]


@pytest.mark.parametrize("score", ["similarity", "relevancy"])
def test_the_default_encoder_is_calibrated_for_the_default_prompts(minilm: TextEncoder, score: str) -> None:
    settings = QuerySettings()
    found = calibration_for(minilm.name, minilm.sha256, score, settings.templates, settings.negatives)
    assert found is not None and found.related < found.exact
    assert calibration_for(minilm.name, "f" * 64, score, settings.templates, settings.negatives) is None
    assert calibration_for(minilm.name, minilm.sha256, score, ("a {}",), settings.negatives) is None


def test_a_chair_is_no_dining_table_though_that_comes_closest(ask: Ask) -> None:
    answer = ask(("dining table", "book", "teddy bear", "cup"), "chair")
    assert answer.matches[0].label == "dining table" and not relevant(answer) and not answer.object_ids
    assert (answer.outcome, answer.relation, answer.probability, answer.presence) == ("not_here", "absent", None, None)
    assert 'none of the 4 names in this scene is "chair"' in answer.sentence and "the closest is" in answer.sentence
    assert ask(("dining table", "book"), "furniture").outcome in ("here", "probably_here")
    assert ask(("cup", "book"), "coffee").outcome == "probably_here"
