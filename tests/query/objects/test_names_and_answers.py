"""What a scene shows as a name can be asked for: names and suggestions are one list, and no answer denies any of it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.common.dictionary import Dictionary, dictionary_of, label_key
from fastsplat.service.perception.lexicon.wordnet import Lexicon
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.query.language.words.query_text import check_query
from fastsplat.service.query.objects.names.names_from_scenes import KnownObject
from fastsplat.service.query.phrases.object_words import ObjectWords
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.ranked_scene import SubscribedQuery
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Object, Objects, Scene, SceneFacts
from fastsplat.service.scene.artefact.suggestions import Suggestion
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.poses import look_at
from fastsplat_contract.messages.queries import Answer
from tests.query.conftest import DrawnEncoder, calibrated
from tests.query.placed_rooms import Room, box, scene_of, table
from tests.scenes import labelled_scene

_NAMES = (
    *("mug", "vase", "dining table", "wall", "wine glass", "glass", "coffee machine", "red scissors", "Teppich"),
    *("how many cups", "mug on the table", "no chair", "of the", "wo ist", "?!", "茶壶", "🧸", "the largest", "xqzw"),
)
_FIRST = 40_001  # ids begin with what stands in no sentence for another reason
_PROBABILITY = st.floats(0.05, 1.0)
_SUGGESTIONS = st.lists(
    st.tuples(st.sampled_from(_NAMES), _PROBABILITY).map(lambda pair: Suggestion(*pair)), max_size=3
)


@st.composite
def _objects(draw: Callable[..., Any]) -> tuple[Object, ...]:
    """Up to five objects with and without names, named by anybody, with suggestions."""
    objects = []
    for number in range(draw(st.integers(1, 5))):
        suggestions = tuple(draw(_SUGGESTIONS))
        name = draw(st.sampled_from(("", "", *_NAMES)))
        if name:
            source = draw(st.sampled_from(("given", "detected", "person")))
            obj = Object(_FIRST + 2 * number, name, source, draw(_PROBABILITY), suggestions=suggestions)
        else:
            obj = Object(_FIRST + 2 * number, suggestions=suggestions)
        objects.append(obj)
    return tuple(objects)


def _scene(objects: tuple[Object, ...], looked_for: list[str]) -> Scene:
    """Four Gaussians an object; the dictionary has their names, and others that were looked for in vain."""
    count = 4 * len(objects)
    dictionary = dictionary_of([*looked_for, *(obj.name for obj in objects if obj.name)])
    rows = np.arange(count)
    owner = np.repeat([obj.id for obj in objects], 4)
    membership = evidence_of(rows, owner, np.full(count, 16 * UNIT), count)
    means = np.stack([rows // 4, rows % 4 / 10, rows % 2 / 10], axis=1)
    return labelled_scene(means, np.zeros(count, int), dictionary, objects=Objects(objects, membership))


def _names(objects: tuple[Object, ...]) -> Mapping[str, set[int]]:
    """By the names that a list of the objects shows, those that bear or may bear them."""
    bearers: dict[str, set[int]] = {}
    for obj in objects:
        suggested = [] if obj.source in ("given", "person") else [suggestion.name for suggestion in obj.suggestions]
        for name in (obj.name, *suggested):
            if name:
                bearers.setdefault(name, set()).add(obj.id)
    return bearers


@given(
    objects=_objects(),
    looked_for=st.lists(st.sampled_from(_NAMES), max_size=6, unique=True),
    encoder=st.sampled_from((calibrated(), DrawnEncoder())),
)
def test_no_name_that_is_shown_is_denied(
    objects: tuple[Object, ...], looked_for: list[str], encoder: DrawnEncoder
) -> None:
    index = SceneIndex(_scene(objects, looked_for), encoder, QuerySettings(backend="reference"))
    bearers = _names(objects)
    table = index.ranked.names.table
    assert {label_key(name.label) for name in table.values()} == {label_key(name) for name in bearers}
    borne = [not name.suggested for name in table.values()]
    assert borne == sorted(borne, reverse=True)
    for answer in index.ask(_NAMES):
        assert answer.outcome != "not_seen" and all(match.gaussian_count for match in answer.matches if match.relevant)
        assert not re.search(r"40\D?0\d\d", answer.sentence)
        assert sum(answer.sentence.count(f'"{match.label}"') for match in answer.matches if match.relevant) > 0 or (
            answer.outcome not in ("here", "probably_here") or not answer.relevant_ids
        )
        bearing = set().union(*(ids for name, ids in bearers.items() if label_key(name) == label_key(answer.text)))
        if bearing:
            assert answer.outcome in ("here", "probably_here") and set(answer.object_ids) <= bearing
            assert answer.object_ids
        if answer.outcome == "not_here":
            assert not answer.object_ids and not answer.relevant_ids
            labels = [match.label for match in answer.matches if match.label not in answer.text]
            assert not any(f'"{label}"' in answer.sentence for label in labels)


@given(objects=_objects())
def test_what_is_suggested_alone_is_as_probable_as_its_likeliest_object(objects: tuple[Object, ...]) -> None:
    index = SceneIndex(_scene(objects, []), calibrated(), QuerySettings(backend="reference"))
    named = {label_key(obj.name) for obj in objects if obj.name}
    for name in _names(objects):
        if label_key(name) not in named:
            likely = {
                obj.id: max(
                    suggestion.probability
                    for suggestion in obj.suggestions
                    if label_key(suggestion.name) == label_key(name)
                )
                for obj in objects
                if obj.source not in ("given", "person")
                and any(label_key(suggestion.name) == label_key(name) for suggestion in obj.suggestions)
            }
            (answer,) = index.ask([name])
            assert answer.outcome == "probably_here"
            assert answer.probability == pytest.approx(max(likely.values()))
            assert answer.object_ids[0] in [key for key in likely if likely[key] == max(likely.values())]
            assert (index.mask3d(answer) == index.objects.rows(answer.object_ids)).all()


_WORDS = ("mug", "coffee", "tea", "fruit", "sofa", "something to read", "furniture", "bicycle", "hammer", "bed linen")


@pytest.mark.parametrize("name", ["cup", "banana", "couch", "book", "dining table"])
def test_words_that_lead_to_a_name_get_its_kind_of_answer(minilm: TextEncoder, lexicon: Lexicon, name: str) -> None:
    """How sure a name is changes what is said of it and of the words for it alike, and only in the probability."""

    def answers(obj: Object) -> list[Answer]:
        index = SceneIndex(_scene((obj,), []), minilm, QuerySettings(backend="reference"), lexicon=lexicon)
        return list(index.ask((name, *_WORDS)))

    sure = answers(Object(1, name, "person", 1.0))
    leading = [answer.outcome in ("here", "probably_here") and (answer.probability or 0) >= 0.5 for answer in sure]
    assert leading[0] and 2 <= sum(leading) < len(sure) - 3
    for probability in (0.06, 0.42, 0.65):
        suggested = answers(Object(1, suggestions=(Suggestion(name, probability),)))
        guessed = answers(Object(1, name, "detected", probability))
        for leads, of_sure, of_suggested, of_guess in zip(leading, sure, suggested, guessed, strict=True):
            assert of_sure.probability is not None
            if leads:
                assert of_suggested.outcome == "probably_here" and of_guess.outcome in ("here", "probably_here")
                assert of_suggested.probability == pytest.approx(probability * of_sure.probability)
                assert of_suggested.object_ids == (1,) and of_suggested.relation == of_sure.relation
                assert f'may be "{name}"' in of_suggested.sentence and of_sure.text in of_suggested.sentence
            elif of_sure.outcome == "not_here":
                assert of_suggested.outcome in ("cannot_say", "not_here") and not of_suggested.relevant_ids


def test_a_label_that_nothing_bears_is_no_name_of_the_scene() -> None:
    """It was looked for; where photos showed it and it is no object's name, what has none may be it."""
    scene, facts = _scene((Object(1), Object(2, "mug", "person", 1.0)), ["vase"]), SceneFacts(searched_for=("vase",))
    index = SceneIndex(replace(scene, facts=facts), DrawnEncoder(), QuerySettings(backend="reference"))
    (vase,) = index.ask(["vase"])
    assert [name.label for name in index.ranked.names.table.values()] == ["mug"] and vase.outcome == "not_here"
    assert vase.sentence.startswith('Not here: nothing bears the name "vase"; 1 object has no name')
    entries = tuple(replace(entry, views=2) for entry in scene.dictionary.entries)
    seen = SceneIndex(replace(scene, dictionary=Dictionary(entries)), DrawnEncoder(), index.settings)
    (vase,) = seen.ask(["vase"])
    assert (vase.outcome, vase.object_ids) == ("cannot_say", (1,)) and "nothing bears that name" in vase.sentence


def test_fragments_of_one_name_are_counted_once(room: SceneIndex) -> None:
    """What lies in the place of another object of its name is no second one; what stands beside it is."""
    objects, owner = room.scene.objects, room.objects.owner.copy()
    assert objects is not None
    owner[np.flatnonzero(owner == 5)[::3]] = 7
    membership = evidence_of(np.arange(len(owner)), owner, np.full(len(owner), 16 * UNIT), len(owner))
    cut = replace(room.scene, objects=Objects((*objects.table, Object(7, "cup", "detected", 0.8)), membership))
    cups, number = SceneIndex(cut, DrawnEncoder(), room.settings).ask(["cups", "how many cups are there?"])
    assert cups.object_ids == number.object_ids == (5, 6, 7) and cups.sentence == 'Here: 2 of "cup".'
    assert number.phrase is not None and number.phrase.count == 2


def test_what_other_scenes_suggest_is_a_suggestion_like_any_other() -> None:
    looks, new_looks = (np.eye(8, dtype=np.float16)[row].tobytes() for row in (0, 1))
    objects = (Object(1, suggestions=(Suggestion("jar", 0.4),), appearance=looks), Object(3, "vase", "person", 1.0))
    index = SceneIndex(_scene(objects, []), DrawnEncoder(), QuerySettings(backend="reference"))
    known = [KnownObject("s", "samovar", looks), KnownObject("own", "jar", looks)]
    ranked = index.ranked.suggesting(known, "own")
    query = check_query(("my samovar", "jar", "vase"), index.settings)
    standing = SubscribedQuery()
    alone, again, more = (standing.ranked(ranking, query) for ranking in (index.ranked, index.ranked, ranked))
    assert again is alone and more is not alone
    samovar, jar, vase = more.answer(lambda: index.objects)
    (suggestion,) = ranked.elsewhere.values()
    assert (samovar.outcome, samovar.probability, samovar.object_ids) == ("probably_here", suggestion.probability, (1,))
    assert (jar.outcome, jar.probability, vase.outcome) == ("probably_here", 0.4, "here")
    assert index.ask(["samovar"])[0].outcome == "cannot_say"  # of this scene alone
    assert (
        index.ranked.suggesting([*known, KnownObject("t", "samovar", new_looks)], "own") is ranked
    )  # it says the same
    assert index.ranked.suggesting(known[1:], "own") is index.ranked


def test_objects_keep_their_sizes_while_no_gaussian_and_no_share_of_an_object_changes() -> None:
    looks = np.eye(8, dtype=np.float16)[0].tobytes()
    scene = replace(_scene((Object(1, appearance=looks), Object(2)), []), scale="METRIC")
    index = SceneIndex(scene, DrawnEncoder(), QuerySettings(backend="reference"))
    (size,) = index.ranked.sizes.values()
    assert list(index.ranked.sizes) == [1] and size.shape == (3,) and 0 <= size[0] <= size[1] <= size[2] < 1
    assert scene.objects is not None
    named = replace(
        scene, objects=replace(scene.objects, table=(Object(1, "mug", "person", 1.0, appearance=looks), Object(2)))
    )
    assert index.after(named).ranked.sizes is index.ranked.sizes
    larger = replace(scene, gaussians=replace(scene.gaussians, means=2 * scene.gaussians.means))
    assert index.after(larger).ranked.sizes[1] == pytest.approx(2 * size)
    assert index.after(replace(scene, scale="ARBITRARY")).ranked.sizes == {}


@pytest.fixture(scope="module")
def room() -> SceneIndex:
    """A lamp, an unnamed object beside it, an unnamed one far away, and four mugs that are unnamed, too."""
    room = Room()
    white = (0.95, 0.95, 0.93)
    names = ["table", "lamp", *[""] * 2, "cup", "cup"]
    room.place("table", table((1.4, 0.8, 0.75)), (0, 0, 0), 0.3, white)
    room.place("lamp", box((0.15, 0.15, 0.4)), (0.2, 0.1, 0.75), 0.2, white)
    room.place("x", box((0.09, 0.09, 0.1)), (0.42, 0.1, 0.75), 0.2, white)
    room.place("x", box((0.09, 0.09, 0.1)), (6.0, 0, 0), 0.2, white)
    room.place("cup", box((0.09, 0.09, 0.1)), (-0.3, 0.1, 0.75), 0.2, white)
    room.place("cup", box((0.09, 0.09, 0.1)), (-0.4, -0.1, 0.75), 0.2, white)
    scene = scene_of(room, 0, np.eye(4))
    assert scene.objects is not None
    suggested = {3: (Suggestion("kettle", 0.19),), 4: (Suggestion("kettle", 0.15), Suggestion("stool", 0.3))}
    rows = tuple(
        Object(obj.id, name, "person" if name else None, float(bool(name)), suggestions=suggested.get(obj.id, ()))
        for obj, name in zip(scene.objects.table, names, strict=True)
    )
    scene = replace(scene, objects=replace(scene.objects, table=rows))
    return SceneIndex(scene, DrawnEncoder(), QuerySettings(backend="cpu"))


def test_objects_are_called_by_their_names_or_by_what_is_beside_them(room: SceneIndex) -> None:
    kettle, stool, cups, all_of_it = room.ask(["kettle", "stool", "cups", "what is on the table?"])
    assert kettle.sentence == (
        'Perhaps here (19 %): the unnamed object beside the "lamp" and an unnamed object may be "kettle".'
    )
    assert kettle.object_ids == (3, 4)
    assert stool.sentence == 'Perhaps here (30 %): an unnamed object may be "stool".'
    assert cups.sentence == 'Here: 2 of "cup".'
    assert all_of_it.sentence == ('Here: "lamp", the unnamed object beside the "lamp" and 2 of "cup", on the table.')


def test_what_is_merely_suggested_has_a_mask_like_a_name(room: SceneIndex) -> None:
    view = PosedCamera(Camera(96, 72, 60.0, 60.0, 48.0, 36.0), look_at((0.4, -1.5, 1.5), (0.2, 0.1, 0.8)))
    kettle, table = room.ask(["kettle", "what is on the table?"])
    for answer in (kettle, table):
        seen = room.mask2d(answer, view)
        assert seen.mask.any() and (seen.mask == room.mask(answer, view)).all()
        assert not seen.label_ids[~seen.mask].any()


def test_at_most_three_are_called_and_the_rest_is_counted() -> None:
    objects = tuple(Object(number, f"object {number}x", "person", 1.0, suggestions=()) for number in range(1, 6))
    index = SceneIndex(_scene(objects, []), DrawnEncoder(), QuerySettings(backend="reference"))
    listed = ObjectWords(index.ranked.names).listed([1, 2, 3, 4, 5], lambda: index.objects.measures)
    assert listed == '"object 1x", "object 2x", "object 3x" and 2 more'
    unnamed = tuple(Object(number, suggestions=(Suggestion("jar", 0.4),)) for number in range(6, 9))
    index = SceneIndex(_scene(unnamed, []), DrawnEncoder(), QuerySettings(backend="reference"))
    assert index.ask(["jar"])[0].sentence == 'Perhaps here (40 %): 3 unnamed objects may be "jar".'
