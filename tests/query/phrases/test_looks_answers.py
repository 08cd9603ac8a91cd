"""Objects are found by their looks where no name answers, weighed with what names say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fastsplat.service.perception.image_text import open_image_text
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.query.language.meaning.common_objects import all_common_objects
from fastsplat.service.query.phrases.object_looks import LooksModel, ObjectLooks, prompt
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Looks, Object, Scene
from fastsplat_contract.messages.queries import Answer
from tests.looks_model import COLORS, MODEL, calibration_of, write_looks_model
from tests.query.box_scenes import rigid
from tests.query.conftest import DrawnEncoder
from tests.query.placed_rooms import Room, scene_of

_WORLD = rigid(3)
_TABLE, _RED, _BLUE, _GREEN = range(1, 5)


def _looks(model: LooksModel, color: str) -> Looks:
    row = np.array(COLORS[color])
    return Looks(model.encoder.sha256, (row / np.linalg.norm(row)).astype(np.float16).tobytes())


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> LooksModel:
    models: Path = tmp_path_factory.mktemp("models")
    write_looks_model(models)
    encoder = open_image_text(PerceptionSettings(image_text=MODEL), models)
    common = encoder.encode([prompt(obj.names[0]) for obj in all_common_objects()])
    return LooksModel(encoder, calibration_of(encoder), common.astype(np.float16))


@pytest.fixture(scope="module")
def scene(model: LooksModel) -> Scene:
    """A table with a red and a blue object without names, and a green book."""
    room = Room.table_with(*((name, (0.5, 0.5, 0.5)) for name in ("crate", "crate", "book")))
    scene = scene_of(room, 0, _WORLD)
    assert scene.objects is not None
    looks = {_RED: _looks(model, "red"), _BLUE: _looks(model, "blue"), _GREEN: _looks(model, "green")}
    rows = (replace(obj, looks=looks.get(obj.id)) for obj in scene.objects.table)
    nameless = {_RED, _BLUE}
    rows_ = tuple(replace(obj, name="", source=None, probability=0.0) if obj.id in nameless else obj for obj in rows)
    return replace(scene, objects=replace(scene.objects, table=rows_))


def _index(scene: Scene, encoder: Any, model: LooksModel | None) -> SceneIndex:
    return SceneIndex(scene, encoder, QuerySettings(backend="cpu"), looks=model)


def _answer(index: SceneIndex, text: str) -> Answer:
    return index.ask([text])[0]


@pytest.mark.parametrize(("text", "obj"), [("the red shiny one", _RED), ("something blue and round", _BLUE)])
def test_words_that_no_name_has_find_what_looks_so(scene: Scene, model: LooksModel, text: str, obj: int) -> None:
    answer = _answer(_index(scene, DrawnEncoder(), model), text)
    assert (answer.outcome, answer.object_ids) == ("probably_here", (obj,)), answer.sentence
    assert answer.probability is not None and 0.5 <= answer.probability < 1
    assert "by its looks" in answer.sentence
    without = _answer(_index(scene, DrawnEncoder(), None), text)
    assert without.outcome != "probably_here" and "looks" not in without.sentence


def test_a_name_goes_before_looks(scene: Scene, model: LooksModel) -> None:
    index = _index(scene, DrawnEncoder(), model)
    named = _answer(index, "the book")
    assert named.object_ids == (_GREEN,) and "looks" not in named.sentence
    assert _answer(index, "the book") == _answer(_index(scene, DrawnEncoder(), None), "the book")


@pytest.mark.parametrize(
    "text",
    [
        *("the red shiny one left of the book", "how many red shiny ones are here?", "the second red shiny one"),
        "a submarine",  # looks like nothing here
    ],
)
def test_looks_tell_neither_places_nor_numbers(scene: Scene, model: LooksModel, text: str) -> None:
    answer, plain = (_answer(_index(scene, DrawnEncoder(), looks), text) for looks in (model, None))
    assert (answer.outcome, answer.object_ids, answer.sentence) == (plain.outcome, plain.object_ids, plain.sentence)


def test_looks_and_what_was_known_before_are_one_likelihood(model: LooksModel) -> None:
    objects = (Object(1, looks=_looks(model, "red")), Object(2, looks=_looks(model, "blue")), Object(3))
    looks = ObjectLooks(objects, model)
    even = looks.likely("red", {1: 0.5, 2: 0.5, 3: 0.5})
    assert list(even) == [1, 2] and even[1] > 0.9 > 0.1 > even[2]
    doubted = looks.likely("red", {1: 0.01, 2: 0.5, 3: 0.5})
    odds = [probability / (1 - probability) for probability in (even[1], doubted[1])]
    assert odds[1] / odds[0] == pytest.approx(0.01 / 0.99, rel=1e-3)


def test_looks_of_another_model_say_nothing(model: LooksModel) -> None:
    other_looks = _looks(model, "red")._replace(sha256="0" * 64)
    assert not ObjectLooks((Object(1, looks=other_looks),), model) and not ObjectLooks((Object(1),), model)
    assert not ObjectLooks((Object(1, looks=_looks(model, "red")),), None)
    counts = model.calibration.held_out.model_copy(update={"matched": 17})
    chance = model.calibration.model_copy(update={"held_out": counts})
    assert not ObjectLooks((Object(1, looks=_looks(model, "red")),), replace(model, calibration=chance))
