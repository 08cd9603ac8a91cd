"""Stand-ins: tiny networks with the contracts of models whose weights are not at hand, and known answers."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from tokenizers import Tokenizer
from tokenizers.models import WordLevel
from tokenizers.normalizers import Lowercase
from tokenizers.pre_tokenizers import Whitespace
from tokenizers.processors import TemplateProcessing

from fastsplat.service.capture.captures import Capture, CaptureReport, GivenLabels, View
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.networks import write_network

WORDS = ["[PAD]", "[CLS]", "[SEP]", ".", "red", "cup", "chair", "lamp"]


@pytest.fixture
def tokenizer_file(tmp_path: Path) -> Path:
    """A BERT-like tokenizer of eight words; ids are positions in WORDS."""
    tokenizer = Tokenizer(WordLevel({word: i for i, word in enumerate(WORDS)}, unk_token="[PAD]"))
    tokenizer.normalizer = Lowercase()
    tokenizer.pre_tokenizer = Whitespace()
    tokenizer.post_processor = TemplateProcessing("[CLS] $A [SEP]", special_tokens=[("[CLS]", 1), ("[SEP]", 2)])
    tokenizer.save(str(tmp_path / "tokenizer.json"))
    return tmp_path / "tokenizer.json"


@pytest.fixture
def clip_file(tmp_path: Path) -> Path:
    """Embeds a text as the sum of one axis per token: token i is the unit vector of axis i."""
    rows = ", ".join(str(float(i == j)) for i in range(8) for j in range(8))
    return write_network(
        tmp_path / "model.onnx",
        f"""
        clip (int64[B,T] input_ids) => (float[B,8] text_embeds)
        <float[8,8] table = {{{rows}}}, int64[1] axes = {{1}}>
        {{
          tokens = Gather(table, input_ids)
          text_embeds = ReduceSum<keepdims = 0>(tokens, axes)
        }}
        """,
    )


@pytest.fixture
def sam2_folder(tmp_path: Path) -> Path:
    """A segmenter whose "object" is the box, its part 10 px smaller of 256 on each side, its group 10 px larger."""
    write_network(
        tmp_path / "sam2" / "encoder.onnx",
        """
        encoder (float[1,3,1024,1024] image)
          => (float[1,32,256,256] high_res_feats_0, float[1,64,128,128] high_res_feats_1,
              float[1,256,64,64] image_embed)
        <int64[4] s0 = {1, 32, 256, 256}, int64[4] s1 = {1, 64, 128, 128}, int64[4] s2 = {1, 256, 64, 64}>
        {
          mean = ReduceMean(image)
          high_res_feats_0 = Expand(mean, s0)
          high_res_feats_1 = Expand(mean, s1)
          image_embed = Expand(mean, s2)
        }
        """,
    )
    write_network(
        tmp_path / "sam2" / "decoder.onnx",
        """
        decoder (float[1,256,64,64] image_embed, float[1,32,256,256] high_res_feats_0,
                 float[1,64,128,128] high_res_feats_1, float[L,N,2] point_coords, float[L,N] point_labels,
                 float[L,1,256,256] mask_input, float[1] has_mask_input)
          => (float[1,3,256,256] masks, float[1,3] iou_predictions)
        <int64 zero = {0}, int64 one = {1}, int64 wide = {256}, float half = {0.5}, float four = {4.0},
         int64[4] as_column = {1, 1, 1, 256}, int64[4] as_row = {1, 1, 256, 1}, int64[4] as_layers = {1, 3, 1, 1},
         float[3] growth = {-10.0, 0.0, 10.0}, float[1,3] quality = {0.9, 0.9, 0.9}, int64[1] flat = {-1}>
        {
          counted = Range(zero, wide, one)
          number = Cast<to = 1>(counted)
          centre = Add(number, half)
          x = Reshape(centre, as_column)
          y = Reshape(centre, as_row)
          scaled = Div(point_coords, four)
          box = Reshape(scaled, flat)
          two = Add(one, one)
          three = Add(two, one)
          x1 = Gather(box, zero)
          y1 = Gather(box, one)
          x2 = Gather(box, two)
          y2 = Gather(box, three)
          a = Sub(x, x1)
          b = Sub(x2, x)
          c = Sub(y, y1)
          d = Sub(y2, y)
          horizontal = Min(a, b)
          vertical = Min(c, d)
          inside = Min(horizontal, vertical)
          layers = Reshape(growth, as_layers)
          masks = Add(inside, layers)
          iou_predictions = Identity(quality)
        }
        """,
    )
    return tmp_path / "sam2"


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """A small label table that passes its trial: a cup is like a mug and unlike a bridge."""
    embeds = np.array([[1, 0.1], [1, 0.2], [0, 1]], np.float32)
    np.savez(tmp_path / "table.npz", names=np.array(["cup", "mug", "bridge"]), embeds=embeds)
    return tmp_path / "table.npz"


def make_capture(images: list[Path], labels: GivenLabels | None = None) -> Capture:
    """Views without meaningful poses: perception looks at images one by one."""
    views = []
    for path in images:
        height, width = cv2.imread(str(path)).shape[:2]
        camera = Camera(width, height, width, width, width / 2, height / 2)
        views.append(View(PosedCamera(camera, np.eye(4), path.name), path))
    nothing = np.zeros((0, 3))
    report = CaptureReport("images", len(views))
    return Capture(tuple(views), nothing.astype(np.float32), nothing.astype(np.uint8), "ARBITRARY", report, labels)


def read_rgb(path: Path) -> np.ndarray:
    """uint8 [H, W, 3]."""
    return cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
