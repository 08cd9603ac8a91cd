"""Laws of answers, with embeddings that a test can set."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import SemanticHead
from fastsplat.service.scene.objects.object_codes import classes_of_codes
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, ModelUnavailableError
from fastsplat_contract.geometry.camera import PosedCamera
from tests.query.conftest import PLAIN, DrawnEncoder, make_scene
from tests.query.decisions import decided

LEANING = {
    "mug": [1.0],
    "cup": [0.8, 0.6],
    "tumbler": [0.97, 0.2431],
    "spoon": [0, 0, 1.0],
    "bed": [0, 0, 0, 1.0],
    "cloud": [0] * 9 + [1.0],
}


@pytest.fixture
def index() -> SceneIndex:
    return SceneIndex(make_scene(), DrawnEncoder(LEANING), PLAIN)


@pytest.mark.parametrize("text", ["mug", "Mugs", "the mug", "Where is the mug?", "MUG", "the old mugs"])
def test_a_name_in_the_hash_table_is_exact(index: SceneIndex, text: str) -> None:
    (answer,) = index.ask([text])
    assert (answer.outcome, answer.relation, answer.text) == ("here", "same", text)
    assert answer.matches[0].label == "mug" and answer.relevant_ids == (1,)


@pytest.mark.parametrize(
    ("text", "verdict", "outcome", "relation", "sentence"),
    [
        ("tumbler", "exact", "here", "same", 'Here: "mug", the same as "tumbler".'),
        ("cup", "related", "probably_here", "related", 'Probably here: "mug", related to "cup".'),
        ("cloud", "absent", "not_here", "absent", 'Not here: none of the 3 names in this scene is "cloud".'),
    ],
)
def test_thresholds_of_ones_own_decide_and_give_no_probability(
    index: SceneIndex, front: PosedCamera, text: str, verdict: str, outcome: str, relation: str, sentence: str
) -> None:
    (answer,), (decision,) = index.ask([text]), decided(index, text)
    assert (decision.verdict, decision.named) == (verdict, False)
    assert (answer.outcome, answer.relation, answer.sentence) == (outcome, relation, sentence)
    assert answer.probability is None and answer.relevant_ids == (() if verdict == "absent" else (1,))
    for mask in (index.mask3d(answer), index.mask2d(answer, front).mask):
        assert mask.any() == bool(answer.relevant_ids)
    assert text != "cup" or answer.matches[0].similarity == pytest.approx(0.8, abs=1e-6)


@pytest.mark.parametrize("score", ["similarity", "relevancy"])
def test_answers_rank_everything_best_first(score: str) -> None:
    labels = [f"word {i}x" for i in range(60)]
    settings = PLAIN.model_copy(update={"score": score, "threshold": 0.2})
    index = SceneIndex(make_scene(labels), DrawnEncoder(), settings)
    for answer in index.ask(["alpha", "beta", "word 7x", "🧸", "茶壶"]):
        assert sorted(match.label_id for match in answer.matches) == list(range(1, 61))
        flags = [match.relevant for match in answer.matches]
        assert flags == sorted(flags, reverse=True)
        for group in (True, False):
            ranked = [getattr(match, score) for match in answer.matches if match.relevant == group]
            assert ranked == sorted(ranked, reverse=True)
        assert (answer.outcome in ("not_here", "cannot_say")) == (not answer.relevant_ids)
        assert (answer.outcome == "cannot_say") == (answer.text == "🧸")  # no word
        assert not answer.relevant_ids or answer.matches[0].label in answer.sentence
        for match in answer.matches:
            assert 0 <= match.relevancy <= 1 and -1 <= match.similarity <= 1
            assert match.nearest_negative in settings.negatives


def test_a_batch_is_its_parts(index: SceneIndex) -> None:
    texts = ["cup", "mug", "cloud", "cup"]
    assert index.ask(texts) == tuple(index.ask([text])[0] for text in texts)


@pytest.mark.parametrize("temperature", [0.0, 1e6])
def test_temperature_moves_relevancy_but_no_verdict(temperature: float) -> None:
    texts = ["cup", "tumbler", "cloud", "the bed", "object"]
    for score in ("similarity", "relevancy"):
        base = PLAIN.model_copy(update={"score": score, "threshold": 0.1})
        hot = base.model_copy(update={"temperature": temperature})
        a, b = (decided(SceneIndex(make_scene(), DrawnEncoder(LEANING), s), *texts) for s in (base, hot))
        assert [x.verdict for x in a] == [x.verdict for x in b]
        assert [[m.label for m in x.answer.matches] for x in a] == [[m.label for m in x.answer.matches] for x in b]


def test_counts_and_masks_agree_with_the_softmax() -> None:
    rng = np.random.default_rng(0)
    scene = make_scene([f"l{i}x" for i in range(30)], per_label=20, code=5)
    head = SemanticHead(rng.standard_normal((31, 5)).astype(np.float32), rng.standard_normal(31).astype(np.float32))
    codes = rng.standard_normal((len(scene.gaussians), 5)).astype(np.float32)
    scene = replace(scene, head=head, gaussians=replace(scene.gaussians, codes=codes), evidence=None)
    logits = codes.astype(np.float64) @ head.weight.T.astype(np.float64) + head.bias
    probability = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
    index = SceneIndex(scene, DrawnEncoder(), PLAIN)
    np.testing.assert_array_equal(index.gaussian_classes, probability.argmax(axis=1))
    label_id = int(np.bincount(probability.argmax(axis=1))[1:].argmax()) + 1
    (answer,) = index.ask([f"l{label_id - 1}x"])
    np.testing.assert_array_equal(index.mask3d(answer), probability.argmax(axis=1) == label_id)
    assert answer.matches[0].gaussian_count == index.mask3d(answer).sum()
    assert sum(match.gaussian_count for match in answer.matches) == (probability.argmax(axis=1) > 0).sum()


def test_classes_of_many_gaussians_do_not_depend_on_the_pieces() -> None:
    rng = np.random.default_rng(0)
    head = SemanticHead(rng.standard_normal((2001, 3)).astype(np.float32), rng.standard_normal(2001).astype(np.float32))
    codes = rng.standard_normal((5000, 3)).astype(np.float32)
    whole = classes_of_codes(codes, head)[0]
    parts = np.concatenate([classes_of_codes(codes[i : i + 997], head)[0] for i in range(0, 5000, 997)])
    assert (whole == parts).mean() > 0.999  # BLAS may round a tie differently for another number of rows


def test_an_uncalibrated_encoder_knows_names_only_and_says_so() -> None:
    index = SceneIndex(make_scene(), DrawnEncoder(LEANING), QuerySettings(backend="reference"))
    assert not index.calibrated
    named, near = index.ask(["mug", "tumbler"])
    assert named.outcome == "here"
    assert near.outcome == "not_here" and "not calibrated" in near.sentence and '"mug"' not in near.sentence
    for answer in (named, near):
        assert answer.probability is None and answer.coverage is None and answer.label_set == ()
        assert answer.presence is None and all(match.probability is None for match in answer.matches)


def test_labels_that_nearly_are_the_same_are_told_apart() -> None:
    labels = ["cup", "cup holder", "cups and plates", "Cup.", "ＣＵＰ ２", "c u p"]
    leaning = {label: [1.0, i * 1e-3] for i, label in enumerate([*labels, "beaker"])}
    index = SceneIndex(make_scene(labels), DrawnEncoder(leaning), PLAIN)
    for i, label in enumerate(labels):
        assert index.ask([label])[0].relevant_ids == (i + 1,)
    assert index.ask(["CUPS"])[0].relevant_ids == (1,)  # the hash table's name, not the nearest embedding
    (answer,) = index.ask(["beaker"])
    assert answer.outcome == "here" and sorted(answer.relevant_ids) == [1, 2, 3, 4, 5, 6]


def test_templates_of_ones_own_embed_the_labels_once() -> None:
    encoder = DrawnEncoder(LEANING)
    index = SceneIndex(make_scene(), encoder, PLAIN)
    encoder.seen.clear()
    first = index.ask(["cup"], templates=["my {}"])
    assert "my mug" in encoder.seen and "my cup" in encoder.seen and "my object" in encoder.seen
    encoder.seen.clear()
    assert index.ask(["cup"], templates=("my {}",)) == first and encoder.seen == []
    few = SceneIndex(make_scene(), DrawnEncoder(), PLAIN.model_copy(update={"max_sentences": 5}))
    assert few.ask(["cup"], templates=["my {}"])
    with pytest.raises(LimitExceededError, match="3 labels in 2 templates"):
        few.ask(["cup"], templates=["my {}", "your {}"])


@pytest.mark.parametrize(
    ("wrong", "error", "field"),
    [
        ({"negatives": []}, InvalidInputError, "negatives"),
        ({"negatives": "object"}, InvalidInputError, "negatives"),
        ({"negatives": [" "]}, InvalidInputError, "negatives"),
        ({"negatives": [3]}, InvalidInputError, "negatives"),
        ({"negatives": ["x"] * 65}, LimitExceededError, "negatives"),
        ({"negatives": ["x" * 1001]}, LimitExceededError, "negatives"),
        ({"templates": []}, InvalidInputError, "templates"),
        ({"templates": ["a photo"]}, InvalidInputError, "templates"),
        ({"templates": ["{} and {}"]}, InvalidInputError, "templates"),
        ({"templates": ["{}\x00"]}, InvalidInputError, "templates"),
        ({"templates": ["a {}"] * 65}, LimitExceededError, "templates"),
        ({"coverage": 0.0}, InvalidInputError, "coverage"),
        ({"coverage": 1.0}, InvalidInputError, "coverage"),
        ({"coverage": np.nan}, InvalidInputError, "coverage"),
        ({"coverage": "0.9"}, InvalidInputError, "coverage"),
    ],
)
def test_wrong_prompts_are_refused(index: SceneIndex, wrong: dict[str, Any], error: type, field: str) -> None:
    with pytest.raises(error) as caught:
        index.ask(["cup"], **wrong)
    assert caught.value.field == field and caught.value.hint


def test_stored_label_embeddings_serve_their_own_encoder_and_templates() -> None:
    stored = np.eye(3, 16, dtype=np.float32)
    stored_scene = replace(make_scene(), label_embeddings=stored, text_encoder=("drawn", "0" * 64))
    for scene, settings, embedded in (
        (stored_scene, PLAIN, False),
        (replace(stored_scene, text_encoder=("drawn", "2" * 64)), PLAIN, True),
        (stored_scene, PLAIN.model_copy(update={"templates": ("a {}",)}), True),
    ):
        encoder = DrawnEncoder()
        SceneIndex(scene, encoder, settings)
        assert any("mug" in text for text in encoder.seen) == embedded


def test_texts_are_embedded_once() -> None:
    encoder = DrawnEncoder()
    index = SceneIndex(make_scene(), encoder, PLAIN.model_copy(update={"cached_texts": 2}))
    encoder.seen.clear()
    index.ask(["cup", "the cup", "cup"])
    index.ask(["cup", "jar"])
    assert encoder.seen == ["cup", "jar"]
    index.ask(["tin"])
    index.ask(["cup"])
    assert encoder.seen == ["cup", "jar", "tin", "cup"]


def test_an_encoder_of_another_size_or_of_nan_is_refused() -> None:
    scene = replace(make_scene(), label_embeddings=np.eye(3, 5, dtype=np.float32), text_encoder=("drawn", "0" * 64))
    for labelled, encoder in ((scene, DrawnEncoder()), (make_scene(), DrawnEncoder({"object": [np.nan]}))):
        with pytest.raises(ModelUnavailableError):
            SceneIndex(labelled, encoder, PLAIN)


def test_an_answer_of_another_scene_is_refused(index: SceneIndex, front: PosedCamera) -> None:
    (foreign,) = SceneIndex(make_scene([f"l{i}x" for i in range(9)]), DrawnEncoder(), PLAIN).ask(["l8x"])
    for use in (index.mask3d, index.objects_of, lambda answer: index.mask2d(answer, front)):
        with pytest.raises(InvalidInputError):
            use(foreign)


@pytest.mark.parametrize("template", ["a", "{} {}"])
def test_templates_in_settings_have_one_slot(template: str) -> None:
    with pytest.raises(ValueError, match="templates"):
        QuerySettings(templates=(template,))
