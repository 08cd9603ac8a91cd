"""Image-text models: pictures and texts in one space, by a made network with the contract of a CLIP."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from fastsplat.service.perception.image_text import ClipImageText, find_image_text, open_image_text
from fastsplat.service.perception.model_pull.model_check import check_model
from fastsplat.service.perception.models.model_manifest import ModelEntry
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat_contract.errors import ModelUnavailableError
from tests.looks_model import MODEL, write_looks_model

_SETTINGS = PerceptionSettings(image_text=MODEL)


@pytest.fixture
def models(tmp_path: Path) -> Path:
    write_looks_model(tmp_path)
    return tmp_path


@pytest.fixture
def model(models: Path) -> ClipImageText:
    return open_image_text(_SETTINGS, models)


def test_none_is_opened_where_the_settings_name_none_and_a_wrong_name_is_said(models: Path) -> None:
    assert find_image_text(PerceptionSettings(), models) is None
    with pytest.raises(ModelUnavailableError, match="elsewhere"):
        find_image_text(PerceptionSettings(image_text="clip:elsewhere"), models)
    with pytest.raises(ModelUnavailableError, match="no image text"):
        find_image_text(PerceptionSettings(image_text="minilm_l6_int8"), models)


def test_a_folder_needs_one_network_of_each(models: Path) -> None:
    shutil.copy(models / "looks" / "image.onnx", models / "looks" / "other.onnx")
    with pytest.raises(ModelUnavailableError, match="network of images"):
        open_image_text(_SETTINGS, models)
    (models / "looks" / "other.onnx").unlink()
    (models / "looks" / "text.onnx").unlink()
    with pytest.raises(ModelUnavailableError, match="network of texts"):
        open_image_text(_SETTINGS, models)


def test_either_network_makes_another_model(models: Path, model: ClipImageText) -> None:
    content = (models / "looks" / "image.onnx").read_bytes()
    folder = models / "other"
    shutil.copytree(models / "looks", folder)
    (folder / "image.onnx").write_bytes(content + b"\x00")
    assert open_image_text(PerceptionSettings(image_text="clip:other"), models).sha256 != model.sha256


def test_a_pulled_model_must_know_a_drawn_stop_sign(models: Path) -> None:
    entry = ModelEntry(name="looks", role="image_text", adapter="clip", license="MIT", about="a stand-in", files=())
    with pytest.raises(ModelUnavailableError, match="stop sign"):  # which knows neither word
        check_model(entry, models)
