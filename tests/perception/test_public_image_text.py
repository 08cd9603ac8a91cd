"""Public image-text models: real architectures with random weights, exported under the public names."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
import transformers
from tokenizers import Tokenizer
from tokenizers.models import WordLevel
from tokenizers.normalizers import Lowercase
from tokenizers.pre_tokenizers import Whitespace
from tokenizers.processors import TemplateProcessing
from transformers.models.clip.image_processing_pil_clip import CLIPImageProcessorPil
from transformers.models.siglip.image_processing_pil_siglip import SiglipImageProcessorPil

from fastsplat.service.perception.image_tensors import read_preprocessing, square_around
from fastsplat.service.perception.image_text import open_image_text
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.text.text_encoders import SentenceEncoder, open_text_encoder
from fastsplat_contract.errors import ModelUnavailableError

pytestmark = pytest.mark.filterwarnings("ignore")  # of the exporter
_MINE = PerceptionSettings(image_text="clip:mine")
_WORDS = ["[PAD]", "[CLS]", "red", "cup", "lamp", "[SEP]"]
_IDS = {"Red cup": [1, 2, 3, 5], "lamp": [1, 4, 5], "red " * 90: [1, *[2] * 90, 5]}
_SIDE = 32
_TINY = {"hidden_size": 32, "intermediate_size": 64, "num_hidden_layers": 2, "num_attention_heads": 2}
_PHOTO = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8).repeat(40, 0).repeat(40, 1)
_Y, _X = np.indices(_PHOTO.shape[:2])
_MASKS = [(abs(_Y - 20 * n - 7) < 8) & (abs(_X - 30 * n) < 3 + 5 * n) for n in range(10)]  # 15 to 95 pixels
_NAMES = {
    "CLIP": ("input_ids", "text_embeds", "pixel_values", "image_embeds"),
    "SigLIP": ("input_ids", "pooler_output", "pixel_values", "pooler_output"),
    "Immich": ("text", "embedding", "image", "embedding"),
}


class _Public(NamedTuple):
    """A framework's model and processor, and the directory where `mine` is its export."""

    model: Any
    processor: Any
    models: Path
    context: int


class _Tower(torch.nn.Module):
    """Features of a model, as exported: of unit length by open_clip alone."""

    def __init__(self, model: Any, what: str, unit: bool) -> None:
        super().__init__()
        self.model, self.what, self.unit = model, what, unit

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        features = getattr(self.model, f"get_{self.what}_features")(values).pooler_output
        return torch.nn.functional.normalize(features) if self.unit else features


def _write_tokenizer(folder: Path, pad_token: object) -> None:
    tokenizer = Tokenizer(WordLevel({word: number for number, word in enumerate(_WORDS)}, unk_token="[PAD]"))
    tokenizer.normalizer, tokenizer.pre_tokenizer = Lowercase(), Whitespace()
    tokenizer.post_processor = TemplateProcessing("[CLS] $A [SEP]", special_tokens=[("[CLS]", 1), ("[SEP]", 5)])
    tokenizer.save(str(folder / "tokenizer.json"))
    (folder / "tokenizer_config.json").write_text(json.dumps({"pad_token": pad_token}))


@pytest.fixture(scope="module", params=["CLIP", "SigLIP", "CLIP of Immich", "SigLIP of Immich"])
def public(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> _Public:
    torch.manual_seed(1)
    models, kind, immich = tmp_path_factory.mktemp("models"), request.param.split()[0], "Immich" in request.param
    context, size = (77, {"shortest_edge": _SIDE}) if kind == "CLIP" else (64, {"height": _SIDE, "width": _SIDE})
    text = {**_TINY, "vocab_size": len(_WORDS), "max_position_embeddings": context, "eos_token_id": 5}
    vision = {**_TINY, "image_size": _SIDE, "patch_size": 8}
    architecture = transformers.CLIPModel if kind == "CLIP" else transformers.SiglipModel
    model = architecture(architecture.config_class(text_config=text, vision_config=vision, projection_dim=24)).eval()
    for parameter in model.parameters():
        parameter.data += 0.1 * torch.randn_like(parameter)  # embeddings that differ
    processor = (CLIPImageProcessorPil if kind == "CLIP" else SiglipImageProcessorPil)(size=size, crop_size=_SIDE)
    images, texts = (models / "mine" / (name if immich else ".") for name in ("visual", "textual"))
    ids, embeds, pixels, looks = _NAMES["Immich" if immich else kind]
    tokens = torch.ones(1, context, dtype=torch.int32 if immich else torch.int64)
    for what, folder, names, example in (
        ("text", texts, (ids, embeds), tokens),
        ("image", images, (pixels, looks), torch.zeros(1, 3, _SIDE, _SIDE)),
    ):
        folder.mkdir(parents=True, exist_ok=True)
        torch.onnx.export(
            _Tower(model, what, immich), (example,), folder / ("model.onnx" if immich else f"{what}_model.onnx"),
            dynamo=False, opset_version=17, input_names=names[:1], output_names=names[1:],
            dynamic_axes=None if immich else {names[0]: [*range(example.ndim)], names[1]: [0]},
        )  # fmt: skip
    _write_tokenizer(texts, "[PAD]" if immich else {"content": "[PAD]"})
    if immich:
        said = {"size": [_SIDE, _SIDE], "mean": processor.image_mean, "std": processor.image_std}
        (images / "preprocess_cfg.json").write_text(json.dumps({**said, "interpolation": "bicubic"}))
    else:
        processor.save_pretrained(images)
    return _Public(model, processor, models, context)


@torch.no_grad()
def test_cosines_are_those_of_the_framework(public: _Public) -> None:
    pixels = public.processor(images=[square_around(_PHOTO, mask)[0] for mask in _MASKS], return_tensors="pt")
    cut = [ids if len(ids) <= public.context else [*ids[: public.context - 1], 5] for ids in _IDS.values()]
    padded = torch.tensor([ids + [0] * (public.context - len(ids)) for ids in cut])
    found = public.model(input_ids=padded, **pixels)
    expected = (found.image_embeds @ found.text_embeds.T).numpy()
    model = open_image_text(_MINE, public.models)
    embeddings = model.embed(_PHOTO, _MASKS)
    assert min(np.ptp(expected, axis=0).min(), np.ptp(expected, axis=1).min()) > 0.02
    np.testing.assert_allclose(embeddings @ model.encode([*_IDS]).T, expected, atol=1e-3)
    np.testing.assert_allclose(model.embed(_PHOTO, _MASKS[3:4])[0], embeddings[3], atol=1e-5)
    canonical = [model.encode([text]) for text in ("Red_cup!", "Red cup")]
    assert np.allclose(*canonical) == (public.context == 64)  # as SigLIP was trained


def test_tensors_are_those_of_the_framework(public: _Public) -> None:
    (path,) = public.models.rglob("preproc*.json")
    for mask in _MASKS:
        square = square_around(_PHOTO, mask)[0]
        expected = public.processor(images=square, return_tensors="np")["pixel_values"]
        np.testing.assert_allclose(read_preprocessing(path, name="mine").tensor(square), expected, atol=2 / 255)


def test_a_text_tower_is_a_text_encoder_by_itself(public: _Public, tmp_path: Path) -> None:
    (tmp_path / "clip_vit_b32").symlink_to(public.models / "mine")
    alone = open_text_encoder("clip_vit_b32", tmp_path)
    np.testing.assert_array_equal(alone.encode([*_IDS]), open_image_text(_MINE, public.models).encode([*_IDS]))


def test_what_does_not_belong_together_is_refused(public: _Public, tmp_path: Path) -> None:
    shutil.copytree(public.models, tmp_path, dirs_exist_ok=True)
    (network,) = {path.resolve() for path in tmp_path.rglob("*.onnx") if "text" in str(path.relative_to(tmp_path))}
    (image,) = {*tmp_path.rglob("*.onnx")} - {network}
    with pytest.raises(ModelUnavailableError, match=r"expected input_ids .* → last_hidden_state .*; it has .* → "):
        SentenceEncoder(network, network.with_name("tokenizer.json"), name="mine")
    (path,) = tmp_path.rglob("preproc*.json")
    said = json.loads(path.read_text())
    for wrong in (
        {"size": [32, 64]},
        {"do_normalize": False},
        {"resample": 9, "interpolation": "random"},
        {"size": None},
    ):
        path.write_text(json.dumps(said | wrong))
        with pytest.raises(ModelUnavailableError, match=next(iter(wrong))):
            open_image_text(_MINE, tmp_path).embed(_PHOTO, _MASKS[:1])
    path.unlink()
    with pytest.raises(ModelUnavailableError, match=r"224|preprocess_cfg"):  # CLIP's and SigLIP's usual size
        open_image_text(_MINE, tmp_path).embed(_PHOTO, _MASKS[:1])
    shutil.copy(network, image)
    with pytest.raises(ModelUnavailableError, match=r"; or image .*; it has"):
        open_image_text(_MINE, tmp_path).embed(_PHOTO, _MASKS[:1])
    _write_tokenizer(network.parent, "[UNKNOWN]")
    if public.context == 64 or network.parent.name == "textual":
        with pytest.raises(ModelUnavailableError, match="names no padding token"):
            open_image_text(_MINE, tmp_path)
