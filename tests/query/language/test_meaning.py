"""What a lexicon adds to answers: relations, probabilities, and nothing where it is off. WordNet comes from npm."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry, dictionary_of
from fastsplat.service.perception.lexicon.wordnet import Lexicon, find_lexicon
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.query.language.meaning.embeddings import TextCache, text_caches
from fastsplat.service.query.language.meaning.label_meanings import BASE, Compounds, LabelMeanings
from fastsplat.service.query.language.meaning.meaning import FILE, MeaningModel, expanded, model_for
from fastsplat.service.query.language.words.name_matching import NameIndex
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.errors import ModelUnavailableError
from fastsplat_contract.messages.queries import Answer
from tests.query.conftest import DrawnEncoder, make_scene

LABELS = ("couch", "banana", "chair", "hammer", "car", "cat", "frying pan", "scissors")
_KITCHEN = ("kettle", "coffee machine", "sink", "cabinet", "countertop", "wall", "bottle", "knife", "spoon")
"""That of the paper (FAST-Splat, section 5)."""
_WORKSHOP = ("hammer", "saw", "vise", "workbench")


@pytest.fixture
def meanings(lexicon: Lexicon, calibrated_encoder: DrawnEncoder) -> Callable[..., LabelMeanings]:
    def make(labels: Sequence[str]) -> LabelMeanings:
        return LabelMeanings(dictionary_of(labels), lexicon, text_caches(calibrated_encoder, QuerySettings()))

    return make


@pytest.fixture
def index(lexicon: Lexicon, calibrated_encoder: DrawnEncoder) -> Callable[..., SceneIndex]:
    def make(labels: Sequence[str] = LABELS, **settings: object) -> SceneIndex:
        scene = make_scene(labels, code=2)
        return SceneIndex(scene, calibrated_encoder, QuerySettings.model_validate(settings), lexicon=lexicon)

    return make


def test_relations_are_the_lexicons(meanings: Callable[..., LabelMeanings]) -> None:
    label_meanings = meanings(LABELS)

    def rows(question: str, relation: str) -> set[str]:
        found = getattr(label_meanings.relations(label_meanings.meaning(question)), relation)
        assert found.min() >= 0 and found.max() <= 1
        return {label for label, value in zip(LABELS, found, strict=True) if value > 0}

    assert rows("sofa", "same") == {"couch"} and rows("sofas", "same") == {"couch"}
    assert "banana" in rows("fruit", "wider") and "couch" not in rows("fruit", "wider")
    assert "chair" in rows("armchair", "narrower")
    assert "car" in rows("car door", "part")
    assert rows("xyzzy", "kinship") == set()
    nearer, farther = (
        label_meanings.relations(label_meanings.meaning(word)).wider[LABELS.index("cat")]
        for word in ("feline", "animal")
    )
    assert nearer > farther > 0
    # "Stool" is a toilet in a rarer sense only.
    stool = meanings(("stool", "can", "toilet")).relations(label_meanings.meaning("toilet")).same
    assert stool[2] == 1.0 > stool[0] > 0


def test_a_label_is_known_by_its_aliases_too(lexicon: Lexicon, calibrated_encoder: DrawnEncoder) -> None:
    entries = (DictionaryEntry("xyzzy", ("couch",)), DictionaryEntry("banana"))
    label_meanings = LabelMeanings(Dictionary(entries), lexicon, text_caches(calibrated_encoder, QuerySettings()))
    assert label_meanings.relations(label_meanings.meaning("sofa")).same.tolist() == [1.0, 0.0]
    assert label_meanings.is_of(Dictionary(entries)) and not label_meanings.is_of(dictionary_of(["xyzzy", "banana"]))


@pytest.mark.parametrize("question", ["sofa", "fruit", "something to sit on", "wall clock", "hit a nail", "xyzzy"])
def test_the_order_of_labels_changes_no_feature(meanings: Callable[..., LabelMeanings], question: str) -> None:
    def columns(labels: Sequence[str]) -> np.ndarray:
        names, label_meanings = NameIndex(dictionary_of(labels)), meanings(labels)
        similarity = np.array([len(label) / 20 for label in labels])
        return label_meanings.compare(question, names.match(question), similarity).columns

    order = [3, 0, 7, 1, 6, 2, 5, 4]
    straight, turned = columns(LABELS), columns([LABELS[place] for place in order])
    assert straight.shape == (len(LABELS), len(BASE)) and np.isfinite(expanded(straight)).all()
    np.testing.assert_allclose(turned, straight[order], atol=1e-6)
    np.testing.assert_allclose(expanded(turned), expanded(straight)[order], atol=1e-6)


@given(arrays(np.float64, st.tuples(st.integers(1, 9), st.just(len(BASE))), elements=st.floats(-9, 9)))
def test_probabilities_are_probabilities_in_the_order_of_the_logits(base: np.ndarray) -> None:
    (model,) = _models().values()
    logits = model.logits(base)
    likely = model.likely(logits)
    presence = model.presence(logits, likely)
    assert ((likely >= 0) & (likely <= 1)).all() and likely.max() <= presence <= 1
    assert (np.diff(likely[np.argsort(logits)]) >= 0).all()
    assert model.presence(logits[:0], likely[:0]) == 0.0
    more = model.presence(np.append(logits, logits.max()), np.append(likely, likely.max()))
    assert more >= presence


def test_scenes_of_one_encoder_share_definitions_and_answer_the_same(
    lexicon: Lexicon, calibrated_encoder: DrawnEncoder, index: Callable[..., SceneIndex]
) -> None:
    """Whatever was embedded before, in whatever company."""
    settings, questions = QuerySettings(), ["sofa", "fruit", "something to sit on", "wall clock", "cat", "xyzzy"]
    caches = text_caches(calibrated_encoder, settings)

    def sharing(labels: Sequence[str]) -> SceneIndex:
        return SceneIndex(make_scene(labels, code=2), calibrated_encoder, settings, lexicon=lexicon, caches=caches)

    first = sharing(LABELS)
    calibrated_encoder.seen.clear()
    again, fewer = sharing(LABELS), sharing(LABELS[3:1:-1])
    assert not [text for text in calibrated_encoder.seen if ":" in text]  # definitions stand after their names
    calibrated_encoder.seen.clear()
    more = sharing(("kettle", *LABELS))
    defined = [text for text in calibrated_encoder.seen if ":" in text]
    assert defined and all(text.startswith("kettle:") for text in defined)
    alone = index(LABELS).ask(questions)
    assert first.ask(questions) == alone == again.ask(questions)
    assert fewer.ask(questions) == index(LABELS[3:1:-1]).ask(questions)
    assert more.ask(questions) == index(("kettle", *LABELS)).ask(questions)


def test_a_shared_cache_keeps_no_more_than_its_size(calibrated_encoder: DrawnEncoder) -> None:
    cache = TextCache(calibrated_encoder, ("{}",), 3)
    whole = cache.embed([f"text {number}" for number in range(50)])
    calibrated_encoder.seen.clear()
    again = cache.embed(["text 49", "text 48", "text 47", "text 46"])
    assert calibrated_encoder.seen == ["text 46"] and np.array_equal(again, whole[:-5:-1])
    assert all(row.base is None for row in cache._recent.values())  # a view would hold the 50 of its batch


def test_owners_of_a_shared_cache_share_its_room_and_nothing_else(calibrated_encoder: DrawnEncoder) -> None:
    cache = TextCache(calibrated_encoder, ("{}",), 4)
    left, right = cache.of("one"), cache.of("other")
    first = left.embed(["text 1", "text 2"])
    calibrated_encoder.seen.clear()
    assert np.array_equal(right.embed(["text 1", "text 2"]), first) and calibrated_encoder.seen == ["text 1", "text 2"]
    calibrated_encoder.seen.clear()
    assert np.array_equal(cache.of("one").embed(["text 1", "text 2"]), first) and calibrated_encoder.seen == []
    right.embed(["text 3", "text 4"])
    assert len(cache._recent) == 4


def test_a_model_of_other_columns_or_prompts_serves_nobody() -> None:
    ((key, model),) = _models().items()
    assert model_for(key, "wordnet", QuerySettings().templates) == model
    assert model.base == BASE and len(model.mean) == expanded(np.zeros((1, len(BASE)))).shape[1]
    assert model_for("another@000000000000", "wordnet", model.templates) is None
    assert model_for(key, "another", model.templates) is None
    assert model_for(key, "wordnet", ("{}",)) is None


def test_without_a_lexicon_or_a_measurement_answers_are_the_encoders(
    index: Callable[..., SceneIndex], calibrated_encoder: DrawnEncoder, lexicon: Lexicon
) -> None:
    questions = ["couch", "sofa", "fruit", "hammer without a cat", "submarine"]
    scene = make_scene(LABELS, code=2)
    plain = SceneIndex(scene, calibrated_encoder, QuerySettings()).ask(questions)
    assert {answer.method for answer in plain} == {"encoder"}
    with_lexicon = index().ask(questions)
    assert {answer.method for answer in with_lexicon} == {"lexicon"}
    assert with_lexicon != plain
    # Thresholds of cosines, another score and other templates are what no model was measured with.
    for settings in ({"threshold": 0.3}, {"exact_threshold": 0.9}, {"score": "relevancy"}, {"templates": ("{}",)}):
        config = QuerySettings.model_validate(settings)
        assert index(LABELS, **settings).ask(questions) == SceneIndex(scene, calibrated_encoder, config).ask(questions)
    alone = index().ask(questions, templates=["{}"])
    assert alone == SceneIndex(scene, calibrated_encoder).ask(questions, templates=["{}"])
    stranger = DrawnEncoder()
    assert SceneIndex(scene, stranger, lexicon=lexicon).ask(questions) == SceneIndex(scene, stranger).ask(questions)
    assert {answer.method for answer in SceneIndex(scene, stranger, lexicon=lexicon).ask(["sofa"])} == {"names"}


def test_names_decide_with_a_lexicon_as_without(index: Callable[..., SceneIndex]) -> None:
    (answer,) = index().ask(["where is the couch?"])
    assert (answer.relation, answer.sentence) == ("same", 'Here: "couch".')
    assert answer.probability == 1.0 and answer.matches[0].label == "couch"
    (answer,) = index(("coffee machine", "cat")).ask(["hammer without a cat"])
    assert answer.matches[-1].label == "cat" and answer.matches[-1].probability == 0.0


def test_an_index_after_an_edit_reads_no_definition_again(
    index: Callable[..., SceneIndex], calibrated_encoder: DrawnEncoder
) -> None:
    before = index()
    calibrated_encoder.seen.clear()
    after = before.after(replace(before.scene, quality={"edited": 1}))
    assert after.ask(["sofa"])[0].method == "lexicon"
    assert not [text for text in calibrated_encoder.seen if ": " in text]


def test_a_lexicon_is_off_by_its_setting_or_where_it_was_never_fetched(tmp_path: Path) -> None:
    assert find_lexicon("", tmp_path) is None and find_lexicon("wordnet", tmp_path) is None
    (tmp_path / "wordnet").mkdir()
    with pytest.raises(ModelUnavailableError, match=r"index\.noun is missing or empty"):
        find_lexicon("wordnet", tmp_path)


@pytest.fixture(scope="session")
def ask(minilm: TextEncoder, lexicon: Lexicon) -> Callable[[Sequence[str], str], Answer]:
    """The default encoder and WordNet over a dictionary."""
    indexes: dict[tuple[str, ...], SceneIndex] = {}

    def ask(labels: Sequence[str], text: str) -> Answer:
        key = tuple(labels)
        if key not in indexes:
            indexes[key] = SceneIndex(make_scene(key, code=2), minilm, lexicon=lexicon)
        return indexes[key].ask([text])[0]

    return ask


@pytest.mark.parametrize(
    ("text", "label"),
    [
        ("light with a match", "candle"),
        ("list of drinks", "chalkboard menu"),
        ("something to cut paper with", "scissors"),
    ],
)
def test_a_use_that_is_said_with_prepositions_is_no_question_of_places(
    ask: Callable[..., Answer], text: str, label: str
) -> None:
    answer = ask(("candle", "chalkboard menu", "scissors", "broom", "wall"), text)
    assert answer.matches[0].label == label and not answer.is_absent and answer.relation != "same"
    assert answer.probability is not None and answer.probability >= 0.5


@pytest.mark.parametrize(
    ("text", "label", "relation", "subject", "sentence"),
    [
        ("sofa", "couch", "same", None, 'Here (# %): "couch", the same as "sofa".'),
        ("automobile", "car", "same", None, 'Here (# %): "car", the same as "automobile".'),
        ("fruit", "banana", "kind_of", "label", 'Here (# %): "banana", a kind of "fruit".'),
        ("feline", "cat", "kind_of", "label", 'Here (# %): "cat", a kind of "feline".'),
        (
            "armchair",
            "chair",
            "kind_of",
            "question",
            'Probably here (# %): "chair", the closest to "armchair", which is a kind of it.',
        ),
    ],
)
def test_the_relation_is_said_in_field_and_sentence(
    ask: Callable[[Sequence[str], str], Answer], text: str, label: str, relation: str, subject: str, sentence: str
) -> None:
    answer = ask(LABELS, text)
    assert answer.matches[0].label == label
    assert (answer.relation, answer.relation_subject, answer.method) == (relation, subject, "lexicon")
    assert answer.sentence == sentence.replace("#", f"{min(99, round(100 * (answer.probability or 0)))}")


@pytest.mark.parametrize(
    ("question", "same", "feigned", "different", "before"),
    [
        ("wicker chair", "chair", "", "", "wicker"), ("where are the wicker chairs?", "chair", "", "", "wicker"),
        ("big wicker chair with a cushion", "chair", "", "", "wicker"),
        ("rocking chair", "chair", "", "", "rocking"), ("velvet sofa", "couch", "", "", "velvet"),
        ("toy car", "", "car", "", ""), ("porcelain cat", "", "cat", "", ""), ("frying pan handle", "", "", "", ""),
        ("push the chair into the car", "", "", "", ""), ("chair", "", "", "", ""),
    ],
)  # fmt: skip
def test_words_before_a_name_leave_it_what_it_is_or_do_not(
    meanings: Callable[..., LabelMeanings], question: str, same: str, feigned: str, different: str, before: str
) -> None:
    found = _compounds(meanings(LABELS), LABELS, question)
    for mask, label in ((found.same_kind, same), (found.feigned, feigned), (found.other_name, different)):
        assert [name for name, there in zip(LABELS, mask, strict=True) if there] == ([label] if label else [])
    assert list(found.before.values()) == ([before] if before else [])


def test_the_lexicon_knows_names_that_end_in_a_name(meanings: Callable[..., LabelMeanings]) -> None:
    labels = ("clock", "dog", "table", "wall")
    for question, same, different in (("wall clock", 0, None), ("prairie dog", None, 1), ("water table", None, 2)):
        found = _compounds(meanings(labels), labels, question)
        assert np.flatnonzero(found.same_kind).tolist() == ([] if same is None else [same])
        assert np.flatnonzero(found.other_name).tolist() == ([] if different is None else [different])


def test_a_name_with_a_word_before_it_is_answered_and_the_word_not_checked(
    ask: Callable[[Sequence[str], str], Answer],
) -> None:
    answer = ask(LABELS, "wicker chair")
    assert answer.matches[0].label == "chair" and not answer.is_absent
    assert (answer.relation, answer.relation_subject) == ("kind_of", "question")
    assert answer.sentence.endswith('; "wicker" was not checked.')
    assert ask(("wall", "cat"), "wall clock").is_absent
    assert ask(LABELS, "toy car").relation != "kind_of"


def _compounds(label_meanings: LabelMeanings, labels: Sequence[str], question: str) -> Compounds:
    names = NameIndex(dictionary_of(labels))
    return label_meanings.compare(question, names.match(question), np.zeros(len(labels))).compounds


@pytest.mark.parametrize(
    "text", ["submarine", "toilet", "piano", "violin", "axe", "hammer throw champion", "banana republic"]
)
def test_what_is_not_there_is_absent(ask: Callable[[Sequence[str], str], Answer], text: str) -> None:
    for labels in (LABELS, _KITCHEN, _WORKSHOP):
        answer = ask(labels, text)
        assert (answer.is_absent, answer.relation, answer.relation_subject) == (True, "absent", None)
        assert (answer.presence or 0) < 0.5 and not answer.relevant_ids


@pytest.mark.parametrize(
    ("labels", "text", "found"),
    [
        (_KITCHEN, "tea", ["kettle", "coffee machine"]),
        (_KITCHEN[1:], "tea", ["coffee machine"]),
        (_KITCHEN, "fork", ["spoon", "knife"]),
        (_KITCHEN, "coffee", ["coffee machine"]),
        (_KITCHEN, "cooking pot", ["kettle"]),
        (_KITCHEN, "water", ["sink", "bottle"]),
        (_WORKSHOP, "mallet", ["hammer"]),
        (("stapler", "cat", "oven"), "stationery", ["stapler"]),  # by the list of common objects, not by WordNet
    ],
)
def test_an_ambiguous_question_is_answered_with_the_precise_label(
    ask: Callable[[Sequence[str], str], Answer], labels: Sequence[str], text: str, found: Sequence[str]
) -> None:
    answer = ask(labels, text)
    relevant = [match.label for match in answer.matches if match.relevant]
    assert not answer.is_absent and relevant[: len(found)] == found and f'"{found[0]}"' in answer.sentence
    assert answer.method == "lexicon" and answer.probability == answer.matches[0].probability


def _models() -> dict[str, MeaningModel]:
    return {key: MeaningModel.model_validate(value) for key, value in json.loads(FILE.read_text()).items()}
