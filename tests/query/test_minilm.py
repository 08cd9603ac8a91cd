"""The paper's disambiguations and the calibration's claims, with the real default encoder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmarks.calibration.calibrate import measure
from service.common.dictionary import dictionary_of
from service.perception.text import TextEncoder, open_text_encoder
from service.query import Answer, QuerySettings, SceneIndex, embed_labels
from service.query.calibration import calibration_for
from service.scene import Scene

# Dictionaries of the scenes in FAST-Splat's figures 1 and 2 and its appendix on disambiguation.
KITCHEN = ("kettle", "coffee machine", "sink", "cabinet", "countertop", "wall", "bottle", "knife", "spoon")
LIVING_ROOM = ("couch", "chair", "vase", "tvmonitor", "pottedplant", "diningtable")
FRUIT_TABLE = ("apple", "pottedplant", "vase", "chair", "bowl")
ABSENT = ("dinosaur", "umbrella", "bicycle", "trombone", "submarine", "giraffe")

Ask = Callable[..., Answer]


@pytest.fixture(scope="session")
def encoder(models_dir: Path) -> TextEncoder:
    return open_text_encoder("minilm_l6_int8", models_dir, threads=1)


@pytest.fixture
def ask(encoder: TextEncoder, make_scene: Callable[..., Scene]) -> Ask:
    def ask(labels: Sequence[str], text: str, **settings: Any) -> Answer:
        index = SceneIndex(make_scene(labels, code=2), encoder, QuerySettings(**settings))
        (answer,) = index.ask([text])
        return answer

    return ask


def relevant(answer: Answer) -> list[str]:
    return [match.label for match in answer.matches if match.relevant]


@pytest.mark.parametrize(
    ("labels", "text", "first"),
    [
        (KITCHEN, "coffee", ["coffee machine"]),
        (KITCHEN, "tea", ["kettle", "coffee machine"]),
        ([label for label in KITCHEN if label != "kettle"][:4], "tea", ["coffee machine"]),
        (KITCHEN, "cooking pot", ["kettle"]),
        (KITCHEN, "fork", ["spoon"]),
        (KITCHEN, "water", ["bottle"]),
        (LIVING_ROOM, "cup", ["vase"]),
        (FRUIT_TABLE, "fruit", ["apple", "pottedplant"]),
    ],
)
def test_the_papers_disambiguations(ask: Ask, labels: Sequence[str], text: str, first: list[str]) -> None:
    answer = ask(labels, text)
    assert answer.verdict == "related"
    assert answer.matches[0].label in first
    assert answer.matches[0].label in answer.explanation


def test_a_fork_is_a_spoon_rather_than_a_knife(ask: Ask) -> None:
    assert relevant(ask(KITCHEN, "fork")) == ["spoon", "knife"]


def test_water_is_in_the_bottle_and_the_kettle(ask: Ask) -> None:
    # The paper's encoder names the coffee machine third; MiniLM prefers the sink, and leaves the machine out.
    assert relevant(ask(KITCHEN, "water")) == ["bottle", "sink", "kettle"]


def test_minilm_calls_a_cooking_pot_a_cooking_spoon(ask: Ask) -> None:
    # A known weakness of the encoder: it goes by the shared word. The kettle comes second.
    answer = ask((*KITCHEN, "cooking spoon"), "cooking pot")
    assert [match.label for match in answer.matches[:2]] == ["cooking spoon", "kettle"]


@pytest.mark.parametrize(("text", "first"), [("fork", "sink"), ("water", "kettle")])
def test_why_similarity_is_the_default(ask: Ask, text: str, first: str) -> None:
    # Ordered by the paper's relevancy, entries that resemble "object" or "things" little overtake better ones.
    by_relevancy = [match.label for match in ask(KITCHEN, text, score="relevancy").matches]
    by_similarity = [match.label for match in ask(KITCHEN, text).matches]
    assert by_relevancy.index(first) < by_similarity.index(first)


@pytest.mark.parametrize("text", ["the kettle", "Where is the coffee machine?", "knives", "a SPOON on the countertop"])
def test_named_things_are_exact(ask: Ask, text: str) -> None:
    assert ask(KITCHEN, text).verdict == "exact"


@pytest.mark.parametrize("labels", [KITCHEN, LIVING_ROOM, FRUIT_TABLE], ids=["kitchen", "living room", "fruit table"])
def test_most_absent_things_are_absent(ask: Ask, labels: Sequence[str]) -> None:
    verdicts = [ask(labels, text).verdict for text in ABSENT]
    assert verdicts.count("absent") >= len(ABSENT) - 1
    assert "exact" not in verdicts


@pytest.mark.parametrize("text", ["🧸", "茶壶", "чайник", "إبريق الشاي", "x" * 1000, "object"])
def test_unusual_texts_get_an_answer(ask: Ask, text: str) -> None:
    answer = ask(KITCHEN, text)
    assert answer.verdict in ("related", "absent") and len(answer.matches) == len(KITCHEN)


def test_stored_embeddings_change_nothing(encoder: TextEncoder, make_scene: Callable[..., Scene]) -> None:
    settings = QuerySettings()
    fresh = make_scene(KITCHEN, code=2)
    stored = replace(
        fresh,
        label_embeddings=embed_labels(dictionary_of(KITCHEN), encoder, settings.templates),
        text_encoder=(encoder.name, encoder.sha256),
        label_templates=settings.templates,
    )
    answers = [SceneIndex(scene, encoder, settings).ask(["fork", "tea"]) for scene in (fresh, stored)]
    assert answers[0] == answers[1]


@pytest.mark.parametrize("score", ["similarity", "relevancy"])
def test_the_default_encoder_is_calibrated_for_the_default_prompts(encoder: TextEncoder, score: str) -> None:
    settings = QuerySettings()
    found = calibration_for(encoder.name, encoder.sha256, score, settings.templates, settings.negatives)
    assert found is not None and found.related < found.exact
    assert calibration_for(encoder.name, "f" * 64, score, settings.templates, settings.negatives) is None
    assert calibration_for(encoder.name, encoder.sha256, score, ("a {}",), settings.negatives) is None


def test_the_committed_calibration_is_what_its_script_measures(encoder: TextEncoder) -> None:
    settings = QuerySettings()
    for score, (measured, figures) in measure(encoder, settings.templates, settings.negatives).items():
        committed = calibration_for(encoder.name, encoder.sha256, score, settings.templates, settings.negatives)
        assert committed is not None
        # int8 kernels of other processors round otherwise.
        assert committed.related == pytest.approx(measured.related, abs=0.02)
        assert committed.exact == pytest.approx(measured.exact, abs=0.02)
        assert figures["auroc_related_against_absent"] > 0.97
