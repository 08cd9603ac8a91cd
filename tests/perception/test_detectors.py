"""Detectors keep their contracts: real weights where they are at hand, stand-ins with known answers elsewhere."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from fastsplat.service.perception.box_ops import box_iou
from fastsplat.service.perception.detectors import open_detectors
from fastsplat.service.perception.detectors.open_detectors import open_closed_set_detector, open_open_set_detector
from fastsplat.service.perception.detectors.picodet import PicoDet
from fastsplat.service.perception.models import model_manifest
from fastsplat.service.perception.models.model_manifest import ROLES, load_manifest
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Detections
from fastsplat.service.perception.segmenters.open_segmenter import SEGMENTERS
from fastsplat.service.perception.text.text_encoders import TEXT_TOWERS
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError
from tests.perception.conftest import read_rgb


def _true_box(test_data: Path, label: str, view: str) -> np.ndarray:
    labels = json.loads(next((test_data / "tabletop").glob("transforms.json")).read_text())["labels"]
    rows, columns = np.nonzero(cv2.imread(str(test_data / "tabletop" / "masks" / f"{view}.png"), -1) == labels[label])
    return np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1], np.float32)


def _best(detections: Detections, label: str) -> np.ndarray:
    return detections.boxes[[name == label for name in detections.labels]][0]


def test_picodet_finds_the_doll_and_the_bed(test_data: Path, models_dir: Path) -> None:
    detector = open_closed_set_detector(PerceptionSettings(threads=2), models_dir)
    image = read_rgb(test_data / "plush" / "images" / "20240212_004001.jpg")
    found = detector.detect(image, 0.5)
    assert {"teddy bear", "bed"} <= set(found.labels)
    assert (found.scores >= 0.5).all()
    assert (found.boxes >= 0).all() and (found.boxes <= [1000, 750, 1000, 750]).all()


def test_picodet_boxes_are_in_pixels_of_the_image(test_data: Path, models_dir: Path) -> None:
    """480×360 is not the network's square: boxes must undo the stretch."""
    detector = open_closed_set_detector(PerceptionSettings(threads=2), models_dir)
    found = detector.detect(read_rgb(test_data / "tabletop" / "images" / "000.jpg"), 0.3)
    overlap = box_iou(_best(found, "cup")[None], _true_box(test_data, "utensil holder", "000")[None])
    assert overlap[0, 0] > 0.8


def test_yolo_world_finds_named_objects(test_data: Path, models_dir: Path) -> None:
    if not (models_dir / "yolo_world_s").is_dir():
        pytest.skip("evaluation weights are not there")
    settings = PerceptionSettings(
        open_set_detector="yolo_world:yolo_world_s", prompt_encoder="label_table:clip_text_vocab", threads=2
    )
    detector = open_open_set_detector(settings, models_dir)
    image = read_rgb(test_data / "tabletop" / "images" / "018.jpg")
    found = detector.detect(image, ["Bananas", "headset", "orange"], 0.1)
    assert set(found.labels) <= {"Bananas", "headset", "orange"}
    for prompt, truth in (("Bananas", "banana"), ("orange", "orange")):
        assert box_iou(_best(found, prompt)[None], _true_box(test_data, truth, "018")[None])[0, 0] > 0.7
    with pytest.raises(InvalidInputError, match="flux capacitor"):
        detector.detect(image, ["flux capacitor"], 0.1)


def test_embedding_prompts_need_an_encoder(models_dir: Path) -> None:
    with pytest.raises(ModelUnavailableError) as caught:
        open_open_set_detector(PerceptionSettings(open_set_detector="yolo_world:yolo_world_s"), models_dir)
    assert caught.value.field == "perception.prompt_encoder"


def test_another_network_breaks_the_contract(clip_file: Path) -> None:
    with pytest.raises(ModelUnavailableError) as caught:
        PicoDet(clip_file, name="mine")
    for part in ("mine", "scale_factor [1, 2]", "input_ids [?, ?]"):
        assert part in caught.value.message


def test_a_missing_model_says_how_to_get_it(tmp_path: Path) -> None:
    with pytest.raises(ModelUnavailableError) as caught:
        open_closed_set_detector(PerceptionSettings(), tmp_path)
    assert "models pull picodet_416" in caught.value.hint


def test_the_manifest_says_which_adapter_drives_a_detector(
    clip_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A closed-set model of another adapter is not opened as if it were PicoDet."""
    (tmp_path / "words").mkdir()
    shutil.copy(clip_file, tmp_path / "words" / "model.onnx")
    entry = load_manifest()[0].model_construct(
        name="words", role="closed_set_detector", adapter="yolo_world", license="MIT", about="", files=()
    )
    monkeypatch.setattr(model_manifest, "load_manifest", lambda: (entry,))
    with pytest.raises(ModelUnavailableError, match="yolo_world") as caught:
        open_closed_set_detector(PerceptionSettings(closed_set_detector="words"), tmp_path)
    assert "picodet" in caught.value.hint


def test_another_closed_set_adapter_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Adapter:
        labels = ("cup",)

        def __init__(self, model: Path, *, name: str, threads: int = 0) -> None:
            self.model = model

    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "model.onnx").touch()
    monkeypatch.setattr(open_detectors, "CLOSED_SET_DETECTORS", {"picodet": Adapter})
    opened = open_closed_set_detector(PerceptionSettings(closed_set_detector="picodet:mine"), tmp_path)
    assert isinstance(opened, Adapter) and opened.model == tmp_path / "mine" / "model.onnx"


def test_a_manifest_cannot_give_a_model_an_adapter_of_another_role(tmp_path: Path) -> None:
    path = tmp_path / "manifest.toml"
    path.write_text(
        '[[model]]\nname = "mine"\nrole = "closed_set_detector"\nadapter = "sam1"\n'
        'license = "MIT"\nabout = ""\nfiles = []\n'
    )
    with pytest.raises(ModelUnavailableError, match="picodet"):
        load_manifest(path)


def test_every_adapter_of_a_role_is_driven_by_something() -> None:
    assert tuple(open_detectors.CLOSED_SET_DETECTORS) == ROLES["closed_set_detector"]
    assert tuple(open_detectors.OPEN_SET_DETECTORS) == ROLES["open_set_detector"]
    assert tuple(SEGMENTERS) == ROLES["segmenter"]
    assert {*TEXT_TOWERS, "label_table"} == set(ROLES["text_encoder"])


@pytest.mark.parametrize("name", ["unknown", "picodet:../secrets", "picodet:", "mobile_sam", "sam1:picodet_416"])
def test_names_that_are_no_detector(name: str, tmp_path: Path) -> None:
    with pytest.raises(ModelUnavailableError, match="detector") as caught:
        open_closed_set_detector(PerceptionSettings(closed_set_detector=name), tmp_path)
    assert caught.value.field == "perception.closed_set_detector"
