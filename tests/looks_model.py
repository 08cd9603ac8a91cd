"""An image-text model of a few operations: a picture is its mean color, a text the sum of its words' colors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from tokenizers import Tokenizer
from tokenizers.models import WordLevel
from tokenizers.normalizers import Lowercase
from tokenizers.pre_tokenizers import Whitespace, WhitespaceSplit

from fastsplat.service.instances.naming.object_appearances import best_sights
from fastsplat.service.jobs.looks_rooms import drawn_rooms
from fastsplat.service.perception.image_text import ClipImageText, open_image_text
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.query.language.meaning.common_objects import all_common_objects, common_objects_digest
from fastsplat.service.query.language.meaning.probability import Logistic
from fastsplat.service.query.phrases.object_looks import Calibration, HeldOut
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


def calibration_of(model: ClipImageText) -> Calibration:
    """A calibration that was not measured."""
    counts, plain = dict.fromkeys(HeldOut.model_fields, 0), Logistic(score=1.0, offset=0.0)
    facts = {"model": model.name, "sha256": model.sha256, "common_objects": common_objects_digest()}
    fit = {"temperature": 0.1, "name": plain, "text": plain, "present": plain}
    held_out = {**counts, "rooms": 9, "labels": 90, "matched": 60}
    return Calibration.model_validate({**facts, **fit, "held_out": held_out})


KNOWING = "clip:knowing"  # as the settings name it
_TAUGHT_TEXT = """
text (int64[B,T] input_ids) => (float[B,32] text_embeds)
<int64[1] axes = {1}>
{
  tokens = Gather(table, input_ids)
  text_embeds = ReduceSum<keepdims = 0>(tokens, axes)
}
"""
_TAUGHT_IMAGE = """
image (float[N,3,32,32] pixel_values) => (float[N,E] image_embeds)
{
  tiles = AveragePool<kernel_shape = [4, 4], strides = [4, 4]>(pixel_values)
  flat = Flatten(tiles)
  drawn = MatMul(flat, draw)
  hidden = Relu(drawn)
  image_embeds = %s
}
"""


def write_knowing_model(models: Path, colors: Mapping[str, tuple[int, int, int]] = MappingProxyType({})) -> None:
    """Put a model into the folder `knowing` that was taught the answers of the drawn rooms: it proves mechanics alone.

    A word has a random code, a text the sum of its words' codes. A picture's code is fitted to its 8 x 8 colors by
    ridge regression of random features (Rahimi and Recht 2007).

    Args:
        colors: more to know: texts for what is of one RGB color, 0..255.
    """
    rng, folder, taught = np.random.default_rng(0), models / "untaught", models / "knowing"
    names = [*(name for obj in all_common_objects() for name in obj.names), *colors]
    ids = {word: n for n, word in enumerate(dict.fromkeys(["[UNK]", *" ".join(names).split()]))}
    tokenizer = Tokenizer(WordLevel(ids, unk_token="[UNK]"))
    tokenizer.normalizer, tokenizer.pre_tokenizer = Lowercase(), WhitespaceSplit()
    folder.mkdir(parents=True)
    tokenizer.save(str(folder / "tokenizer.json"))
    table = rng.normal(size=(len(ids), 32)).astype(np.float32)
    table[[ids[word] for word in ("a", "photo", "of") if word in ids]] = 0
    write_network(folder / "text.onnx", _TAUGHT_TEXT, table=table)
    draw = rng.normal(size=(192, 1024)).astype(np.float32)
    write_network(folder / "image.onnx", _TAUGHT_IMAGE % "Identity(hidden)", draw=draw)
    model, features, texts = open_image_text(PerceptionSettings(image_text="clip:untaught"), models), [], list[str]()
    for room in drawn_rooms():
        for object_id, sights in best_sights(enumerate(ids for _, ids in room.views), room.labels).items():
            features += [model.embed(room.views[sight.view][0], [sight.mask])[0] for sight in sights]
            texts += [room.labels[object_id]] * len(sights)
    for text, color in colors.items():
        picture = np.full((32, 32, 3), color, np.uint8)
        features += [*model.embed(picture, [np.ones((32, 32), np.bool_)])] * 100
        texts += [text] * 100
    rows = np.stack(features).astype(np.float64)
    codes = np.linalg.solve(rows.T @ rows + 1e-3 * np.eye(1024), rows.T @ model.encode(texts))
    folder.rename(taught)
    constants = {"draw": draw, "codes": codes.astype(np.float32)}
    write_network(taught / "image.onnx", _TAUGHT_IMAGE % "MatMul(hidden, codes)", **constants)
