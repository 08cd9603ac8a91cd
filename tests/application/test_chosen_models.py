"""The choice of models: what the environment names goes before it, and an open server follows it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fastsplat.service.application.service import open_service
from fastsplat.service.jobs.needed_models import in_use, lacking
from fastsplat.service.perception.onnx_session import file_sha256
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.settings import Settings
from tests.api.made_scene import ENCODER, write_words
from tests.looks_model import MODEL, write_looks_model
from tests.scenes import labelled_scene, store_scene


def test_a_model_that_is_set_goes_before_the_chosen_one(tmp_path: Path) -> None:
    write_looks_model(tmp_path)
    digest = file_sha256(tmp_path / "looks" / "text.onnx")
    choice = {"image_text": {"name": MODEL, "sha256": {"text.onnx": digest}}}
    settings = Settings(models=tmp_path)
    assert in_use(settings, choice).perception.image_text == MODEL and not lacking(settings, choice)
    for folder, sha256 in (("nowhere", {}), ("looks", {"text.onnx": "0" * 64})):
        missing = {"image_text": {"name": f"clip:{folder}", "sha256": sha256}}
        assert lacking(settings, missing) == [f"clip:{folder}"]
        unset = settings.model_copy(update={"perception": PerceptionSettings(image_text="")})
        assert in_use(unset, missing).perception.image_text == "" and not lacking(unset, missing)


def test_an_open_server_answers_by_the_models_that_are_chosen_next(tmp_path: Path) -> None:
    write_words(tmp_path / "models")
    write_looks_model(tmp_path / "models")
    settings = Settings(data_dir=tmp_path / "data", models=tmp_path / "models")
    with open_service(settings.model_copy(update={"perception": PerceptionSettings(text_encoder=ENCODER)})) as service:
        store, scenes = service._store, service._context.scenes
        encoder = scenes._encoder(ENCODER)
        scene_id = store_scene(store, labelled_scene(np.zeros((2, 3)), [1, 0], ["mug"], encoder=encoder))
        before = scenes.open(scene_id, "")[0]
        assert scenes.open(scene_id, "")[0] is before
        store.models.choose({"image_text": {"name": MODEL, "sha256": {}}})
        after = scenes.over(store).open(scene_id, "")[0]
        assert after is not before and scenes.open(scene_id, "")[0] is after
        models = {model.role: model.name for model in service.status("reader", "").models}
        assert models["image_text"] == MODEL and models["text_encoder"] == ENCODER


def test_a_file_that_takes_the_place_of_another_is_read_anew(tmp_path: Path) -> None:
    path = tmp_path / "model.onnx"
    path.write_bytes(b"first")
    first = file_sha256(path)
    (tmp_path / "new").write_bytes(b"other")
    (tmp_path / "new").rename(path)
    assert file_sha256(path) != first
