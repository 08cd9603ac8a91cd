"""Orders to look again: what is refused at once, and that the same order is the same operation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.application.jobs.naming_orders import look_again_job
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.settings import Settings, StoreOptions
from fastsplat_contract.errors import (
    ConflictError,
    FastSplatError,
    InvalidInputError,
    ModelUnavailableError,
    NotFoundError,
    NotReadyError,
)
from fastsplat_contract.jobs.look_again import LookAgainIn
from tests.scenes import labelled_scene, queued_job, store_scene

_DETECTOR = PerceptionSettings(open_set_detector="grounding_dino_tiny")


@pytest.fixture
def open_at(tmp_path: Path) -> Iterator[Callable[..., tuple[SceneService, str]]]:
    """Opens a service with a READY scene; returns both."""
    opened: list[SceneService] = []

    def open_with(**settings: object) -> tuple[SceneService, str]:
        service = open_service(Settings(data_dir=tmp_path / "data", **settings))
        opened.append(service)
        return service, store_scene(service._store, labelled_scene(np.zeros((2, 3)), [1, 0], ["mug"]))

    yield open_with
    for service in opened:
        service.close()


@pytest.mark.parametrize(
    ("texts", "reason", "field", "limit"),
    [
        ((), "INVALID_INPUT", "texts", "1 to 3 texts"),
        (("a", "b", "c", "d"), "LIMIT_EXCEEDED", "texts", "3 texts"),
        (("cup", ""), "INVALID_INPUT", "texts[1]", "1 to 200 characters"),
        (("  \t ",), "INVALID_INPUT", "texts[0]", "1 to 200 characters"),
        (("x" * 41,), "LIMIT_EXCEEDED", "texts[0]", "40 characters"),
        (("x" * 100_000,), "LIMIT_EXCEEDED", "texts[0]", "40 characters"),
        (("two\nlines",), "INVALID_INPUT", "texts[0]", ""),
        (("bell\a",), "INVALID_INPUT", "texts[0]", ""),
        (("nul\0",), "INVALID_INPUT", "texts[0]", ""),
        (("half \ud800",), "INVALID_INPUT", "texts[0]", ""),
        (("cup", "lamp", "Cups "), "INVALID_INPUT", "texts[2]", "each text once"),
        (("...",), "INVALID_INPUT", "texts[0]", ""),
    ],
    ids=lambda value: repr(value)[:24],
)
def test_texts_that_cannot_be_looked_for_are_refused(
    open_at: Callable[..., tuple[SceneService, str]], texts: tuple[str, ...], reason: str, field: str, limit: str
) -> None:
    service, scene_id = open_at(perception=_DETECTOR, store=StoreOptions(max_labels=3, max_label_chars=40))
    with pytest.raises(FastSplatError) as caught:
        service.look_again(scene_id, LookAgainIn(texts))
    assert (caught.value.reason, caught.value.field) == (reason, field)
    assert limit in caught.value.limit
    assert [operation.kind for operation in service.list_operations().operations] == ["create_scene"]


def test_texts_of_other_scripts_are_looked_for() -> None:
    job = look_again_job("s", LookAgainIn(("  茶碗", "größe XL", "🏆")), "default", Settings(perception=_DETECTOR))
    assert job.order["texts"] == ["茶碗", "größe XL", "🏆"]


@pytest.mark.parametrize(
    ("perception", "field", "hints"),
    [
        (
            PerceptionSettings(),
            "perception.open_set_detector",
            "FASTSPLAT_PERCEPTION__OPEN_SET_DETECTOR; open-set detector; grounding_dino_tiny; models list",
        ),
        (PerceptionSettings(open_set_detector="nobody"), "perception.open_set_detector", ""),
        (PerceptionSettings(open_set_detector="yolo_world:mine"), "perception.prompt_encoder", ""),
        (
            PerceptionSettings(open_set_detector="yolo_world:mine", prompt_encoder="label_table:none"),
            "label_table:none",
            "",
        ),
    ],
)
def test_a_detector_that_cannot_look_is_said_at_once(
    open_at: Callable[..., tuple[SceneService, str]], perception: PerceptionSettings, field: str, hints: str
) -> None:
    service, scene_id = open_at(perception=perception)
    with pytest.raises(ModelUnavailableError) as caught:
        service.look_again(scene_id, LookAgainIn(("trophy",)))
    assert caught.value.field == field and all(part in caught.value.hint for part in hints.split("; "))


def test_words_that_the_prompt_encoder_cannot_know_are_named_at_once(
    open_at: Callable[..., tuple[SceneService, str]], tmp_path: Path
) -> None:
    (tmp_path / "models" / "words").mkdir(parents=True)
    np.savez(tmp_path / "models" / "words" / "w.npz", names=np.array(["cup"]), embeds=np.ones((1, 4), np.float32))
    perception = PerceptionSettings(open_set_detector="yolo_world:mine", prompt_encoder="label_table:words")
    service, scene_id = open_at(perception=perception, models=tmp_path / "models")
    with pytest.raises(InvalidInputError, match="does not know: trophy") as caught:
        service.look_again(scene_id, LookAgainIn(("Cups", "trophy")))
    assert caught.value.field == "texts"
    assert service.look_again(scene_id, LookAgainIn(("Cups",))).state == "QUEUED"


def test_only_a_scene_that_is_ready_is_looked_at(open_at: Callable[..., tuple[SceneService, str]]) -> None:
    service, _ = open_at(perception=_DETECTOR)
    with pytest.raises(NotFoundError):
        service.look_again("0" * 32, LookAgainIn(("trophy",)))
    unfinished = queued_job()
    service._store.scenes.create(unfinished)
    with pytest.raises(NotReadyError):
        service.look_again(unfinished.scene_id, LookAgainIn(("trophy",)))
    with pytest.raises(NotFoundError):
        service.in_project("other").look_again(unfinished.scene_id, LookAgainIn(("trophy",)))


def test_the_same_request_is_the_same_operation(open_at: Callable[..., tuple[SceneService, str]]) -> None:
    service, scene_id = open_at(perception=_DETECTOR)
    first = service.look_again(scene_id, LookAgainIn(("trophy",), "one"))
    assert service.look_again(scene_id, LookAgainIn((" trophy",), "one")) == first
    assert service.look_again(scene_id, LookAgainIn(("trophy",))).id != first.id
    with pytest.raises(ConflictError):
        service.look_again(scene_id, LookAgainIn(("lamp",), "one"))
    with pytest.raises(InvalidInputError):
        service.look_again(scene_id, LookAgainIn(("trophy",), "no spaces, please"))
    assert service.get_scene(scene_id).state == "READY"
