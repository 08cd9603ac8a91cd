"""An image-text model of a few operations: a picture is its mean color, a text the sum of its words' colors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tokenizers import Tokenizer
from tokenizers.models import WordLevel
from tokenizers.normalizers import Lowercase
from tokenizers.pre_tokenizers import Whitespace

from tests.networks import write_network

MODEL = "clip:looks"  # as the settings name it
COLORS = {"red": (1.0, -1.0, -1.0), "green": (-1.0, 1.0, -1.0), "blue": (-1.0, -1.0, 1.0)}
_GRAY = (0.1, 0.1, 0.1)  # of all other words

_IMAGE = """
image (float[N,3,32,32] pixel_values) => (float[N,3] image_embeds)
{
  image_embeds = ReduceMean<axes = [2, 3], keepdims = 0>(pixel_values)
}
"""
_TEXT = """
text (int64[B,T] input_ids) => (float[B,3] text_embeds)
<float[%d,3] table = {%s}, int64[1] axes = {1}>
{
  tokens = Gather(table, input_ids)
  text_embeds = ReduceSum<keepdims = 0>(tokens, axes)
}
"""


def write_looks_model(models: Path, colors: Mapping[str, tuple[float, float, float]] = COLORS) -> None:
    """Put the model into the folder `looks` of a model directory."""
    folder = models / "looks"
    table = ", ".join(str(number) for row in (_GRAY, *colors.values()) for number in row)
    for name, network in (("image.onnx", _IMAGE), ("text.onnx", _TEXT % (len(colors) + 1, table))):
        write_network(folder / name, network)
    words = Tokenizer(WordLevel({"[UNK]": 0, **{word: n for n, word in enumerate(colors, start=1)}}, unk_token="[UNK]"))
    words.normalizer = Lowercase()
    words.pre_tokenizer = Whitespace()
    words.save(str(folder / "tokenizer.json"))
