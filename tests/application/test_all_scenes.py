"""A question to all scenes is answered as each would answer it, from what is kept of them without their Gaussians."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fastsplat.service.application.answering import open_scenes
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.language.meaning.embeddings import embed_labels
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Object, Parts, Scene, SceneFacts, SemanticHead
from fastsplat.service.scene.artefact.suggestions import Suggestion
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of, posterior
from fastsplat.service.settings import Settings
from fastsplat_contract.messages.queries import Answer, QueryRequest
from fastsplat_contract.messages.scenes import Edit
from tests.application.conftest import ENCODER, LABELS
from tests.query.box_scenes import rigid
from tests.query.placed_rooms import Room, box, scene_of, table
from tests.scenes import labelled_scene, store_scene

PLAIN = ("mug", "something to drink from", "banana", "a grand piano", "handle")
PHRASES = (
    "the mug on the table",
    "how many mugs are there?",
    "the red object",
    "the largest banana",
    "the piano on the table",
    "how many pianos are there?",
    "the mug next to the blorb",
)


@pytest.fixture
def settings(settings: Settings, models_dir: Path) -> Settings:
    return settings.model_copy(update={"models": models_dir})


@pytest.fixture(scope="module")
def encoder(models_dir: Path) -> TextEncoder:
    return open_text_encoder(ENCODER, models_dir)


@pytest.fixture(scope="module")
def scenes(encoder: TextEncoder) -> dict[str, Scene]:
    """Labels by codes, by objects, with parts, with objects that have no name, and none at all."""
    room = Room()
    room.place("table", table((1.4, 0.8, 0.75)), (0, 0, 0), 0.3, (0.7, 0.55, 0.4))
    room.place("mug", box((0.09, 0.09, 0.1)), (0.2, 0.1, 0.75), 0.2, (0.75, 0.1, 0.1))
    room.place("mug", box((0.09, 0.09, 0.1)), (1.5, 0, 0), 0.2, (0.1, 0.2, 0.75))
    scene = scene_of(room, 0, rigid(3))
    assert scene.objects is not None
    one_hot = np.eye(len(scene.dictionary) + 1, dtype=np.float32)
    label_ids = np.array([0, *(scene.dictionary.id_of(obj.name) for obj in scene.objects.table)])
    owner = posterior(scene.objects.membership, len(label_ids)).classes
    scene = replace(
        scene,
        gaussians=replace(scene.gaussians, codes=one_hot[label_ids[owner]]),
        head=SemanticHead(8.0 * one_hot, np.zeros(len(one_hot), np.float32)),
        label_embeddings=embed_labels(scene.dictionary, encoder),
        text_encoder=(encoder.name, encoder.sha256),
        label_templates=QuerySettings().templates,
        facts=SceneFacts(searched_names=80, searched_for=("banana", "submarine")),
    )
    assert scene.objects is not None
    first, *rest = scene.objects.table
    unnamed = replace(
        scene.objects, table=(replace(first, suggestions=(Suggestion("piano", 0.6),), name="", source=None), *rest)
    )
    count = len(scene.gaussians)
    (rows,) = np.nonzero(np.arange(count) % 50 == 7)
    inside = evidence_of(rows, np.full(len(rows), 9, np.int32), np.full(len(rows), 16 * UNIT, np.int64), count)
    parts = Parts((Object(9, "mug", "person", 0.8, parent=1),), inside)
    labelled = {"encoder": encoder, "templates": QuerySettings().templates}
    two = labelled_scene([[-0.5, 0, 2], [0.5, 0, 2]], [1, 2], LABELS, **labelled)
    return {
        "objects": scene,
        "codes": two,
        "unnamed": replace(scene, objects=unnamed),
        "parts": replace(scene, objects=replace(scene.objects, parts=parts)),
        "no labels": labelled_scene([[0, 0, 2]], [0], (), **labelled),
    }


@pytest.fixture
def stored(service: SceneService, scenes: dict[str, Scene]) -> dict[str, str]:
    """Their ids, the newest first."""
    return dict(reversed([(name, store_scene(service._store, scene)) for name, scene in scenes.items()]))


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    names: list[str] = []
    read = open_scenes.read_scene

    def reading(folder: Path) -> Scene:
        names.append(folder.parent.parent.name)
        return read(folder)

    monkeypatch.setattr(open_scenes, "read_scene", reading)
    return names


def _alone(service: SceneService, stored: dict[str, str], request: QueryRequest) -> tuple[Answer, ...]:
    """The answers of each scene to a question to it alone, open."""
    return tuple(
        answer
        for scene_id in stored.values()
        for answer in service.answers.query(replace(request, scene_id=scene_id)).answers
    )


def _close(service: SceneService) -> None:
    """As when other scenes needed the memory."""
    service._context.scenes._open.drop(lambda key: True)


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"max_matches": 1, "coverage": 0.5, "negatives": ("stuff",), "templates": ("a {}",)},
        {"outputs": frozenset({"objects"})},
        {"outputs": frozenset({"mask3d", "objects"})},
        {"outputs": frozenset({"mask3d"}), "mask3d_encoding": "runs"},
    ],
)
def test_all_scenes_answer_as_each_alone(service: SceneService, stored: dict[str, str], more: dict[str, Any]) -> None:
    request = QueryRequest("", (*PLAIN, *PHRASES), **more)
    expected = _alone(service, stored, request)
    assert {answer.outcome for answer in expected} >= {"here", "probably_here", "not_here"} or "negatives" in more
    assert service.answers.query(request).answers == expected  # from open scenes, and from what is kept of them
    _close(service)
    assert service.answers.query(request).answers == expected


@pytest.mark.parametrize("text", ["mug", "a grand piano", "the piano on the table"])
def test_the_gaussians_of_no_answer_are_an_empty_file(service: SceneService, stored: dict[str, str], text: str) -> None:
    request = QueryRequest("", (text,), outputs=frozenset({"mask3d"}), mask3d_encoding="ply")
    assert service.answers.query(request).answers == _alone(service, stored, request)


def test_a_plain_question_reads_no_file_of_a_scene_twice(
    service: SceneService, stored: dict[str, str], opened: list[str]
) -> None:
    request = QueryRequest("", PLAIN)
    expected = service.answers.query(request).answers
    assert opened == list(stored.values())
    for scene_id in stored.values():
        artefact = service._store.blobs.version(scene_id, "1") / "artefact"
        artefact.rename(artefact.with_name("away"))
    _close(service)
    out = service.answers.query(request)
    assert (out.answers, out.skipped_count) == (expected, 0) and len(opened) == len(stored)


def test_what_needs_gaussians_opens_only_scenes_that_answer(
    service: SceneService, stored: dict[str, str], opened: list[str]
) -> None:
    service.answers.query(QueryRequest("", ("mug",)))

    def opens(text: str, *outputs: str) -> set[str]:
        _close(service)
        opened.clear()
        service.answers.query(QueryRequest("", (text,), outputs=frozenset(outputs)))
        assert len(opened) == len(set(opened))
        return {name for name, scene_id in stored.items() if scene_id in opened}

    assert opens("banana", "mask3d") == opens("banana", "objects") == {"codes"}
    assert opens("banana") == opens("a submarine", "mask3d", "objects") == set()
    assert opens("a grand piano", "mask3d", "objects") == {"unnamed"}  # where a piano is suggested
    # What is measured is measured where the head of the phrase is named; a scene without objects has to look for some.
    with_objects = set(stored) - {"codes", "no labels"}
    assert opens("the table next to the mug") >= {"objects", "parts"}
    assert not opens("the banana next to the mug") & with_objects
    assert not opens("how many bananas are there?", "mask3d") & with_objects


def test_a_new_version_and_a_deleted_scene_are_noticed(service: SceneService, stored: dict[str, str]) -> None:
    request = QueryRequest("", ("mug", "teacup"))
    before = service.answers.query(request).answers
    service.versions.edit(stored["objects"], [Edit("name", object_ids=(2,), name="teacup")], looked_at="1")
    after = service.answers.query(request).answers
    assert after == _alone(service, stored, request)
    changed = {new.scene_id for old, new in zip(before, after, strict=True) if old != new}
    assert changed == {stored["objects"]}
    service.delete_scene(stored["codes"])
    assert {answer.scene_id for answer in service.answers.query(request).answers} == set(stored.values()) - {
        stored["codes"]
    }
    assert all(key[0] != stored["codes"] for key in service._context.scenes._ranked._slots)


def test_what_is_kept_of_a_scene_does_not_grow_with_its_gaussians(
    scenes: dict[str, Scene], encoder: TextEncoder
) -> None:
    few = scenes["codes"]
    rows = np.arange(5_000) % len(few.gaussians)
    many = replace(few, gaussians=type(few.gaussians)(**{k: v[rows] for k, v in vars(few.gaussians).items()}))
    indices = [SceneIndex(scene, encoder) for scene in (few, many)]
    ranked = [index.ranked for index in indices]
    assert ranked[0].nbytes == ranked[1].nbytes and len(ranked[1].blank) == 5_000
    assert all(not any(array.strides) for array in vars(ranked[1].blank).values())  # one number stands for all
    gone = [weakref.ref(obj) for obj in (many.gaussians, indices[1])]
    del many, indices
    gc.collect()
    assert [ref() for ref in gone] == [None, None]


def test_with_room_for_one_scene_all_are_answered(
    settings: Settings, service: SceneService, stored: dict[str, str]
) -> None:
    request = QueryRequest("", PLAIN)
    expected = service.answers.query(request).answers
    assert len(service._context.scenes._ranked) == len(stored) and service._context.scenes._ranked.bytes < 10e6
    calls = settings.calls.model_copy(update={"ranking_memory_bytes": 1})
    with open_service(settings.model_copy(update={"calls": calls})) as small:
        assert small.answers.query(request).answers == expected == small.answers.query(request).answers
        assert len(small._context.scenes._ranked) == 1
