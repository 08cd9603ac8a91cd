"""An image-text model that knows drawn rooms is calibrated on them, names and answers; another one suggests."""

from __future__ import annotations

import shutil
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.instances.naming.naming import NAMED_FROM
from fastsplat.service.instances.naming.object_appearances import pooled_embedding
from fastsplat.service.jobs.looks_calibration import calibrate_image_text
from fastsplat.service.jobs.looks_rooms import drawn_rooms
from fastsplat.service.jobs.names_by_looks import named_by_looks
from fastsplat.service.perception.image_text import open_image_text
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.query.language.meaning.common_objects import common_objects_digest
from fastsplat.service.query.phrases.looks_files import EMBEDDINGS, FACTS, find_looks, save_calibration
from fastsplat.service.query.phrases.object_looks import LooksModel
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Looks, Object, Objects, Scene
from fastsplat.service.scene.objects.label_evidence import no_evidence
from fastsplat_contract.errors import ModelUnavailableError
from tests.looks_model import KNOWING, MODEL, write_knowing_model, write_looks_model
from tests.query.box_scenes import rigid
from tests.query.conftest import DrawnEncoder
from tests.query.placed_rooms import Room, scene_of

_COLORS = {"lava lamp": (255, 0, 255), "trophy": (255, 255, 0), "aquarium": (0, 255, 255)}
"""What the detector's 80 words do not cover."""


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    models = tmp_path_factory.mktemp("models")
    write_knowing_model(models, _COLORS)
    write_looks_model(models)
    for name, rooms in ((KNOWING, 17), (MODEL, 5)):
        model = open_image_text(PerceptionSettings(image_text=name), models)
        save_calibration(*calibrate_image_text(model, rooms=islice(drawn_rooms(), rooms)), models)
    return models


def _found(name: str, models: Path) -> LooksModel:
    found = find_looks(PerceptionSettings(image_text=name), models)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def seen(models: Path) -> dict[str, tuple[Object, ...]]:
    """By model: nameless objects that it looked at, in the order of `_COLORS`."""
    objects = {}
    for name in (KNOWING, MODEL):
        model = open_image_text(PerceptionSettings(image_text=name), models)
        pictures = [np.full((40, 40, 3), color, np.uint8) for color in _COLORS.values()]
        rows = [pooled_embedding(model.embed(picture, [np.ones((40, 40), np.bool_)])) for picture in pictures]
        objects[name] = tuple(Object(n, looks=Looks(model.sha256, row.tobytes())) for n, row in enumerate(rows, 1))
    return objects


def test_a_model_that_knows_is_measured_and_errs_elsewhere_as_it_says(models: Path) -> None:
    calibration = _found(KNOWING, models).calibration
    counts = calibration.held_out
    assert calibration.measured and counts.rooms == 17 and counts.given > 100
    assert counts.given_right == pytest.approx(counts.expected, rel=0.1)
    assert counts.denied / counts.present < 0.1 and counts.refused / counts.absent > 0.9
    assert f"{counts.given_right} of {counts.given} right" in calibration.summary


def test_a_model_that_does_not_know_is_refused(models: Path) -> None:
    calibration = _found(MODEL, models).calibration
    assert not calibration.measured and "is not calibrated" in calibration.summary
    assert calibration.held_out.given == 0


def test_objects_are_named_by_looks_unless_a_person_did(models: Path, seen: dict[str, tuple[Object, ...]]) -> None:
    lamp, trophy, tank = seen[KNOWING]
    doubted = replace(trophy, name="cup", source="detected", probability=0.99)
    objects = Objects((lamp, doubted, replace(tank, name="Oskar", source="person", probability=1.0)), no_evidence(3))
    named = named_by_looks(objects, _found(KNOWING, models), ["cup"]).table
    assert [obj.name for obj in named] == ["lava lamp", "cup", "Oskar"]
    assert named[0].probability >= NAMED_FROM and "trophy" in {said.name for said in named[1].suggestions}
    guessed = named_by_looks(Objects(seen[MODEL], no_evidence(3)), _found(MODEL, models), [])
    assert not any(obj.name for obj in guessed.table)


@pytest.fixture(scope="module")
def scene(seen: dict[str, tuple[Object, ...]]) -> Scene:
    """A table with three objects that the detector has no word for."""
    scene = scene_of(Room.table_with(*[("crate", (0.5, 0.5, 0.5))] * 3), 0, rigid(3))
    assert scene.objects is not None
    first, *crates = scene.objects.table
    nameless = [
        replace(obj, name="", source=None, probability=0.0, looks=looked.looks)
        for obj, looked in zip(crates, seen[KNOWING], strict=True)
    ]
    return replace(scene, objects=replace(scene.objects, table=(first, *nameless)))


def test_any_word_is_answered_by_looks(models: Path, scene: Scene) -> None:
    model = _found(KNOWING, models)
    index, blind = (SceneIndex(scene, DrawnEncoder(), QuerySettings(), looks=looks) for looks in (model, None))
    for number, text in enumerate(_COLORS, start=2):
        (answer,), (before,) = index.ask([f"where is the {text}?"]), blind.ask([f"where is the {text}?"])
        assert (answer.outcome, answer.object_ids) == ("probably_here", (number,)), answer.sentence
        assert answer.probability is not None and answer.probability >= 0.5 and "by its looks" in answer.sentence
        assert before.outcome == "cannot_say"
    (absent,), (unknown,) = index.ask(["a violin"]), index.ask(["Ermintrude"])
    assert (absent.outcome, absent.object_ids) == ("not_here", ()), absent.sentence
    assert blind.ask(["a violin"])[0].outcome == unknown.outcome == "cannot_say"
    unlooked = replace(scene.objects, table=(*scene.objects.table[:-1], replace(scene.objects.table[-1], looks=None)))
    partly = SceneIndex(replace(scene, objects=unlooked), DrawnEncoder(), QuerySettings(), looks=model)
    assert partly.ask(["a violin"])[0].outcome == "cannot_say"


def test_a_calibration_is_of_these_files_and_this_list(models: Path, tmp_path: Path) -> None:
    shutil.copytree(models / "knowing", folder := tmp_path / "knowing")
    settings = PerceptionSettings(image_text=KNOWING)
    assert find_looks(settings, tmp_path) is not None
    (folder / FACTS).write_text((folder / FACTS).read_text().replace(common_objects_digest(), "0" * 64))
    assert find_looks(settings, tmp_path) is None
    shutil.copytree(models / "knowing", changed := tmp_path / "changed")
    (changed / "image.onnx").write_bytes((changed / "image.onnx").read_bytes() + b"\0")
    assert find_looks(PerceptionSettings(image_text="clip:changed"), tmp_path) is None
    assert find_looks(PerceptionSettings(), tmp_path) is None
    (folder / EMBEDDINGS).write_bytes(b"damaged")
    with pytest.raises(ModelUnavailableError, match=EMBEDDINGS):
        find_looks(settings, tmp_path)
