"""An object's descriptor is most like that of the same object in other pictures: the demo's photos, real features."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import onnxruntime
import pytest

from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.perception import onnx_session
from fastsplat.service.perception.appearance import (
    SIZE,
    AppearanceEncoder,
    descriptor_of,
    open_appearance_encoder,
    small_picture,
)
from fastsplat.service.perception.onnx_session import open_session
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat_contract.errors import ModelUnavailableError
from tests.networks import write_network

_SAMPLE = Path(__file__).parents[2] / "demo" / "sample"
_OBJECTS = ("banana", "bottle", "bowl", "clock", "cup", "plate", "potted plant", "teddy bear", "vase")


@pytest.fixture(scope="module")
def encoder(models_dir: Path) -> AppearanceEncoder:
    return open_appearance_encoder(PerceptionSettings(), models_dir)


def _seen(encoder: AppearanceEncoder, views: tuple[int, ...]) -> np.ndarray:
    """float32 [objects, SIZE] from these views of the sample."""
    names = json.loads((_SAMPLE / "transforms.json").read_text())["instances"]
    rows = []
    for name in _OBJECTS:
        features = []
        for view in views:
            ids = cv2.imread(str(_SAMPLE / f"instances/{view:03d}.png"), cv2.IMREAD_UNCHANGED)
            mask = ids == names.index(name) + 1
            if mask.sum() > 200:
                features.append(encoder.features(load_rgb(_SAMPLE / f"images/{view:03d}.jpg"), mask))
        rows.append(descriptor_of(features).astype(np.float32))
    return np.stack(rows)


def test_objects_are_most_like_themselves_from_elsewhere(encoder: AppearanceEncoder) -> None:
    low, high = _seen(encoder, (1, 5, 9)), _seen(encoder, (13, 17, 22))
    likeness = low @ high.T
    assert likeness.argmax(axis=1).tolist() == likeness.argmax(axis=0).tolist() == list(range(len(_OBJECTS)))
    off_diagonal = likeness[~np.eye(len(_OBJECTS), dtype=bool)]
    assert np.diag(likeness).min() > off_diagonal.max()
    assert np.allclose(np.linalg.norm(low, axis=1), 1, atol=1e-2) and low.shape[1] == SIZE


@pytest.mark.parametrize("place", [np.s_[:, :], np.s_[:1, :1], np.s_[-5:, 100:103], np.s_[40:41, :]])
def test_any_mask_has_a_finite_descriptor_and_a_picture(encoder: AppearanceEncoder, place: tuple[slice, ...]) -> None:
    image = load_rgb(_SAMPLE / "images/003.jpg")
    mask = np.zeros(image.shape[:2], np.bool_)
    mask[place] = True
    descriptor = descriptor_of([encoder.features(image, mask)])
    assert descriptor.shape == (SIZE,) and descriptor.dtype == np.float16 and np.isfinite(descriptor).all()
    picture = cv2.imdecode(np.frombuffer(small_picture(image, mask), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (96, 96, 3)


def test_a_detector_of_another_kind_has_no_descriptors(models_dir: Path) -> None:
    settings = PerceptionSettings(closed_set_detector="picodet:nowhere")
    with pytest.raises(ModelUnavailableError):
        open_appearance_encoder(settings, models_dir)


def test_values_inside_a_network_become_outputs_by_their_names(tmp_path: Path) -> None:
    network = write_network(
        tmp_path / "n.onnx",
        "n (float[1, 2] x) => (float[1, 2] y) {first = Neg (x) \n a_longer_name = Exp (first) \n y = Abs (first)}",
    )
    session = open_session(network, name="n", inner=("a_longer_name", "first"))
    x = np.array([[1, -2]], np.float32)
    y, exponential, first = session.run(None, {"x": x})
    assert np.array_equal(first, -x) and np.allclose(exponential, np.exp(-x)) and np.array_equal(y, abs(x))
    with pytest.raises(ModelUnavailableError, match=r"n\.onnx"):
        open_session(network, name="n", inner=("nothing",))


@pytest.mark.parametrize(
    ("backend", "built", "first"), [("cuda", True, "CUDA"), ("cuda", False, "CPU"), ("cpu", True, "CPU")]
)
def test_networks_run_where_training_does_if_they_can(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, backend: str, built: bool, first: str
) -> None:
    """A GPU is not at hand: what onnxruntime was built for and what it is asked for are read instead."""
    network = write_network(tmp_path / "n.onnx", "n (float[1] x) => (float[1] y) {y = Abs (x)}")
    wanted: list[list[str]] = []
    providers = ["CUDAExecutionProvider"] * built + ["CPUExecutionProvider"]
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: providers)
    monkeypatch.setattr(onnxruntime, "InferenceSession", lambda *_, providers: wanted.append(list(providers)))
    monkeypatch.setattr(onnx_session, "_providers", [])
    onnx_session.use_backend(backend)
    open_session(network, name="n")
    assert wanted[0][0] == f"{first}ExecutionProvider" and wanted[0][-1] == "CPUExecutionProvider"
