"""Public open-set detectors: real architectures with random weights, exported under the public names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
import transformers
from transformers.models.grounding_dino import modeling_grounding_dino
from transformers.models.grounding_dino.image_processing_pil_grounding_dino import GroundingDinoImageProcessorPil
from transformers.models.owlv2.image_processing_pil_owlv2 import Owlv2ImageProcessorPil
from transformers.models.owlvit.image_processing_pil_owlvit import OwlViTImageProcessorPil

from fastsplat.service.perception.box_ops import nms
from fastsplat.service.perception.detectors.grounding_dino import GroundingDino
from fastsplat.service.perception.detectors.owl import OwlV2, OwlViT
from fastsplat.service.perception.detectors.yolo_world import YoloWorld
from fastsplat.service.perception.label_maps import capture_detection
from fastsplat.service.perception.label_maps.capture_detection import CaptureDetector
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Detections, joined
from fastsplat.service.perception.text.text_encoders import LabelTable
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError
from tests.networks import write_network
from tests.perception.conftest import WORDS

pytestmark = pytest.mark.filterwarnings("ignore")  # what tracing bakes in: see the tests

_PHOTO = np.random.default_rng(0).integers(0, 256, (1350, 1800, 3), np.uint8)
_PROMPTS = ("Red Cup", "chair", "lamp")
_IDS = [[1, 4, 5, 2], [1, 6, 2], [1, 7, 2]]  # of `_PROMPTS` by the tokenizer of WORDS, one a text
_TINY = {"hidden_size": 32, "intermediate_size": 32, "num_hidden_layers": 1, "num_attention_heads": 2}
_OUTPUTS = {"owl": ["logits", "pred_boxes", "text_embeds", "image_embeds"], "dino": ["logits", "pred_boxes"]}


class _Traced(torch.nn.Module):
    """A model with inputs and outputs by position, as tracing wants them."""

    def __init__(self, model: Any, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        super().__init__()
        self.model, self.inputs, self.outputs = model, inputs, outputs

    def forward(self, *values: torch.Tensor) -> tuple[torch.Tensor, ...]:
        found = self.model(**dict(zip(self.inputs, values, strict=True)))
        return tuple(found[name] for name in self.outputs)


def _export(model: Any, path: Path, example: dict[str, torch.Tensor], outputs: list[str], open_axes: Any) -> Path:
    torch.onnx.export(
        _Traced(model, list(example), outputs).eval(), tuple(example.values()), path, dynamo=False, opset_version=17,
        input_names=list(example), output_names=outputs, dynamic_axes=open_axes,
    )  # fmt: skip
    return path


def _owl(version: str, side: int, path: Path) -> tuple[Any, Path]:
    torch.manual_seed(0)
    text = {**_TINY, "vocab_size": len(WORDS), "max_position_embeddings": 16, "bos_token_id": 1, "eos_token_id": 2}
    vision = {**_TINY, "image_size": side, "patch_size": side // 4}
    config = getattr(transformers, f"{version}Config")(text_config=text, vision_config=vision, projection_dim=32)
    model = getattr(transformers, f"{version}ForObjectDetection")(config).eval()
    model.class_head.logit_scale.weight.data *= 0.1  # scores that differ
    words = torch.ones(1, 16, dtype=torch.int64)
    example = {"input_ids": words, "pixel_values": torch.zeros(1, 3, side, side), "attention_mask": words}
    texts = {0: "text_batch_size", 1: "sequence_length"}
    pixels = {0: "image_batch_size", 1: "num_channels", 2: "height", 3: "width"}
    open_axes = {"input_ids": texts, "attention_mask": texts, "pixel_values": pixels}
    return model, _export(model, path / f"{version}.onnx", example, _OUTPUTS["owl"], open_axes)


def _masks_by_loop(ids: torch.Tensor, special_tokens: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Attention and positions within phrases by a loop over their ends, whose length tracing bakes in."""
    ends = torch.nonzero((ids[..., None] == special_tokens).any(-1))[:, 1]
    mask, positions, previous = torch.eye(ids.shape[1])[None].bool(), torch.zeros_like(ids), 0
    for number in range(len(ends)):
        end = ends[number]
        if 0 < end < ids.shape[1] - 1:
            mask[0, previous + 1 : end + 1, previous + 1 : end + 1] = True
            positions[0, previous + 1 : end + 1] = torch.arange(0, end - previous)
        previous = end
    return mask, positions


def _masks_at_once(ids: torch.Tensor, special_tokens: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """As `_masks_by_loop`, of operations that ONNX has."""
    is_end, index = (ids[..., None] == special_tokens).any(-1), torch.arange(ids.shape[1])
    phrase = is_end.long().cumsum(1) - is_end.long()
    earlier = torch.where(is_end[:, None] & (index < index[:, None]), index, -1).amax(-1)
    return phrase[:, :, None] == phrase[:, None], index - earlier - 1


@pytest.fixture(scope="module")
def dino(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, dict[str, Path]]:
    """The model, and its exports traced with one phrase: with the loop of its releases, and without."""
    torch.manual_seed(0)
    size = {"encoder_ffn_dim": 32, "decoder_ffn_dim": 32, "encoder_attention_heads": 2, "decoder_attention_heads": 2}
    config = transformers.GroundingDinoConfig(
        backbone_config=transformers.SwinConfig(
            image_size=64, embed_dim=8, depths=[1, 1], num_heads=[1, 1], window_size=2, out_features=["stage2"]
        ),
        text_config=transformers.BertConfig(**_TINY, vocab_size=len(WORDS), max_position_embeddings=256),
        num_queries=8, d_model=32, encoder_layers=1, decoder_layers=1, num_feature_levels=2,
        decoder_bbox_embed_share=False, **size,
    )  # fmt: skip
    model = transformers.GroundingDinoForObjectDetection(config).eval()
    model.model.special_tokens = torch.tensor([1, 2, 3])
    ids, photo = torch.tensor([[1, 4, 3, 2]]), torch.ones(1, 64, 64, dtype=torch.int64)
    example = {
        "pixel_values": torch.zeros(1, 3, 64, 64), "input_ids": ids, "token_type_ids": torch.zeros_like(ids),
        "attention_mask": torch.ones_like(ids), "pixel_mask": photo,
    }  # fmt: skip
    open_axes = {name: {1: "sequence_length"} for name in ("input_ids", "token_type_ids", "attention_mask")}
    exports, folder = {}, tmp_path_factory.mktemp("dino")
    with pytest.MonkeyPatch.context() as patch:
        encoder = modeling_grounding_dino.GroundingDinoEncoder
        points = encoder.get_reference_points  # traced as float64, which onnxruntime cannot sample at
        in_float32 = staticmethod(lambda *of, **device: points(*of, **device).double().float())
        patch.setattr(encoder, "get_reference_points", in_float32)
        for name, masks in (("baked", _masks_by_loop), ("good", _masks_at_once)):
            patch.setattr(modeling_grounding_dino, "generate_masks_with_special_tokens_and_transfer_map", masks)
            exports[name] = _export(model, folder / f"{name}.onnx", example, _OUTPUTS["dino"], open_axes)
    return model, exports


@pytest.fixture
def fed(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, np.ndarray]]:
    """What networks are fed from now on."""
    feeds, run = [], onnxruntime.InferenceSession.run
    monkeypatch.setattr(
        onnxruntime.InferenceSession, "run", lambda self, names, feed: feeds.append(feed) or run(self, names, feed)
    )
    return feeds


def _expected(processor: Any, found: Any, prompts: Sequence[str], photo: np.ndarray) -> Detections:
    """All boxes as the framework's processor reads its model's outputs, but for duplicates."""
    height, width = photo.shape[:2]
    (read,) = processor.post_process_object_detection(found, threshold=0.0, target_sizes=[(height, width)])
    boxes = np.clip(read["boxes"].numpy(), 0, np.array([width, height, width, height], np.float32))
    scores, labels = read["scores"].numpy(), read["labels"].numpy()
    every = Detections(boxes, scores, tuple(prompts[label] for label in labels))
    rows = [np.flatnonzero(labels == label) for label in range(len(prompts))]
    return joined([every.take(some[nms(boxes[some], scores[some], 0.6)]) for some in rows])


def _assert_alike(found: Detections, expected: Detections, photo: np.ndarray) -> None:
    assert found.labels == expected.labels and len(found) > 2
    np.testing.assert_allclose(found.scores, expected.scores, atol=1e-3)
    np.testing.assert_allclose(found.boxes / max(photo.shape), expected.boxes / max(photo.shape), atol=1e-3)


@pytest.mark.parametrize("version", ["Owlv2", "OwlViT"])
def test_owl_sees_scores_and_boxes_as_the_framework(
    version: str, tokenizer_file: Path, tmp_path: Path, fed: list[dict[str, np.ndarray]]
) -> None:
    adapter = OwlV2 if version == "Owlv2" else OwlViT
    model, path = _owl(version, adapter.preprocessing.size, tmp_path)
    processor = Owlv2ImageProcessorPil() if version == "Owlv2" else OwlViTImageProcessorPil()
    found = adapter(path, tokenizer_file, name="owl").detect(_PHOTO, _PROMPTS, 0.0)
    # This release of the framework pads with black; the model was trained with gray.
    square = np.full((1800, 1800, 3), 127.5)
    square[:1350] = _PHOTO
    pixels = processor(square if version == "Owlv2" else _PHOTO, return_tensors="pt").pixel_values
    assert np.abs(fed[0]["pixel_values"] - pixels.numpy()).max() <= 2 / 255
    assert [
        ids[mask > 0].tolist() for ids, mask in zip(fed[0]["input_ids"], fed[0]["attention_mask"], strict=True)
    ] == _IDS
    with torch.no_grad():
        outputs = model(**{name: torch.from_numpy(value) for name, value in fed[0].items()})
    _assert_alike(found, _expected(processor, outputs, _PROMPTS, _PHOTO), _PHOTO)


def test_owl_refuses_a_long_label_and_looks_for_nothing(tokenizer_file: Path, tmp_path: Path) -> None:
    detector = OwlViT(_owl("OwlViT", 64, tmp_path)[1], tokenizer_file, name="owl")
    assert detector.detect(_PHOTO, [], 0.0).labels == ()
    with pytest.raises(InvalidInputError) as caught:
        detector.detect(_PHOTO, ["chair", "cup " * 15], 0.0)
    assert "16" in caught.value.limit


@pytest.mark.parametrize("export", ["baked", "good"])
def test_grounding_dino_sees_scores_and_boxes_as_the_framework(
    export: str, dino: Any, tokenizer_file: Path, fed: list[dict[str, np.ndarray]]
) -> None:
    """Of the baked export only the first phrase of a prompt is right, which opening sees: then a pass has no other."""
    model, processor = dino[0], GroundingDinoImageProcessorPil(size={"height": 64, "width": 64})
    detector = GroundingDino(dino[1][export], tokenizer_file, name="dino")
    fed.clear()
    found = detector.detect(_PHOTO, _PROMPTS, 0.0)
    passes = [[prompt] for prompt in _PROMPTS] if export == "baked" else [_PROMPTS]
    pixels = processor(_PHOTO, return_tensors="pt").pixel_values.numpy()
    expected = []
    for prompts, feed in zip(passes, fed, strict=True):
        assert np.abs(feed["pixel_values"] - pixels).max() <= 2 / 255
        phrases = [_IDS[_PROMPTS.index(prompt)][1:-1] for prompt in prompts]
        assert feed["input_ids"].tolist() == [[1, *(token for phrase in phrases for token in [*phrase, 3]), 2]]
        with torch.no_grad():
            outputs = model(**{name: torch.from_numpy(value) for name, value in feed.items()})
        columns, scores = 1, []
        for phrase in phrases:  # of unlike length: the mean over tokens, as the authors evaluate classes
            scores.append(outputs.logits[..., columns : columns + len(phrase)].sigmoid().mean(-1).logit())
            columns += len(phrase) + 1
        named = SimpleNamespace(logits=torch.stack(scores, -1), pred_boxes=outputs.pred_boxes)
        expected.append(_expected(processor, named, prompts, _PHOTO))
    _assert_alike(found, joined(expected), _PHOTO)


def test_grounding_dino_splits_what_is_longer_than_its_text(
    dino: Any, tokenizer_file: Path, fed: list[dict[str, np.ndarray]]
) -> None:
    detector = GroundingDino(dino[1]["good"], tokenizer_file, name="dino")
    fed.clear()
    assert detector.detect(_PHOTO, [], 0.0).labels == () and not fed
    detector.detect(_PHOTO, ["cup"] * 128, 0.0)
    assert [feed["input_ids"].shape[1] for feed in fed] == [256, 4]
    with pytest.raises(InvalidInputError, match="no word"):
        detector.detect(_PHOTO, ["..."], 0.4)
    with pytest.raises(InvalidInputError) as caught:
        detector.detect(_PHOTO, ["cup " * 300], 0.4)
    assert "256" in caught.value.limit


_YOLO = """
    yolo (float[B,3,H,W] images, float[B,N,4] {prompts}) => ({outputs})
    <float[1,4,3] anchors = {{0.9, 0.8, 0.1, 0.1, 0.1, 0.85, 0, 0, 0, 0, 0, 0}}, float[1,4,3] centers =
     {{320, 324, 32, 320, 320, 160, 64, 64, 64, 32, 32, 64}}, float[1,3,4] corners =
     {{288, 304, 352, 336, 292, 304, 356, 336, 0, 128, 64, 192}}>
    {{
      by_prompt = MatMul({prompts}, anchors)
      {rows}
    }}
"""
_CONTRACTS = {
    "txt_feats": ("float[B,C,3] output0", "output0 = Concat<axis = 1>(centers, by_prompt)"),
    "text_embeds": (
        "float[1,3,4] boxes_xyxy, float[B,3,N] scores",
        "boxes_xyxy = Identity(corners) scores = Transpose<perm = [0, 2, 1]>(by_prompt)",
    ),
}


@pytest.mark.parametrize("prompts", _CONTRACTS)
def test_yolo_world_is_read_by_the_names_of_its_file(prompts: str, table: Path, tmp_path: Path) -> None:
    """Two of three boxes of the letterboxed square are one cup; one lies half outside of the photo."""
    outputs, rows = _CONTRACTS[prompts]
    network = write_network(tmp_path / "yolo.onnx", _YOLO.format(prompts=prompts, outputs=outputs, rows=rows))
    np.savez(table, names=np.array(["cup", "bridge"]), embeds=np.eye(4, dtype=np.float32)[:2])
    detector = YoloWorld(network, LabelTable(table, name="table"), name="yolo")
    found = detector.detect(np.zeros((100, 200, 3), np.uint8), ["bridge", "cup"], 0.5)
    assert found.labels == ("cup", "bridge")
    np.testing.assert_allclose(found.scores, [0.9, 0.85], atol=1e-6)
    np.testing.assert_allclose(found.boxes, [[90, 45, 110, 55], [0, 0, 20, 10]], atol=1e-4)
    assert detector.detect(np.zeros((100, 200, 3), np.uint8), [], 0.0).labels == ()


def test_a_slow_open_set_detector_looks_at_fewer_views(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As many as 240 s allow by the time of the first, two at a time, spread over the capture; of two, both."""
    outputs, rows = _CONTRACTS["txt_feats"]
    write_network(tmp_path / "mine" / "m.onnx", _YOLO.format(prompts="txt_feats", outputs=outputs, rows=rows))
    (tmp_path / "words").mkdir()
    np.savez(tmp_path / "words" / "w.npz", names=np.array(["cup"]), embeds=np.eye(4, dtype=np.float32)[:1])
    settings = PerceptionSettings(open_set_detector="yolo_world:mine", prompt_encoder="label_table:words", threads=2)
    messages: list[str] = []

    def chosen(seconds: float, count: int) -> list[int]:
        clock = iter((5.0, 5.0 + seconds))
        monkeypatch.setattr(capture_detection, "monotonic", lambda: next(clock))
        detector = CaptureDetector(
            lambda _: _PHOTO, count, ["cup"], settings, tmp_path, lambda done, text: messages.append(text)
        )
        views = detector.limited()
        assert all(map(len, detector.detections(range(len(views)))))
        return views

    assert chosen(96.0, 9) == [0, 2, 4, 6, 8]
    assert messages[-1].endswith("view 5/5")
    assert chosen(1.0, 9) == list(range(9))
    assert chosen(1e4, 9) == [0, 8]


def test_a_yolo_world_of_another_contract_is_refused(table: Path, tmp_path: Path) -> None:
    def refusal(inputs: str) -> str:
        text = f"yolo ({inputs}) => (float[1,3,640,640] output0) {{ output0 = Identity(images) }}"
        with pytest.raises(ModelUnavailableError) as caught:
            YoloWorld(write_network(tmp_path / "yolo.onnx", text), LabelTable(table, name="table"), name="mine")
        return caught.value.message

    assert "closed set" in refusal("float[1,3,640,640] images")
    message = refusal("float[1,3,640,640] images, float[1,8] words")
    assert "txt_feats [1, ?, ?] → output0 [1, ?, ?]" in message and "words [1, 8] → output0 [1, 3, 640, 640]" in message
