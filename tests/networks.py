"""Networks of a few operations, written as ONNX's text form: stand-ins for models whose weights are not at hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import onnx.parser
from numpy.typing import NDArray
from onnx import numpy_helper

EXTENT = """
  numbers = Cast<to = 1>(mask)
  plane = Squeeze(numbers, channels)
  columns = ReduceMax<axes = [1], keepdims = 0>(plane)
  lines = ReduceMax<axes = [2], keepdims = 0>(plane)
  most = ReduceMax<axes = [1], keepdims = 1>(columns)
  left = ArgMax<axis = 1, keepdims = 1>(columns)
  right = ArgMax<axis = 1, keepdims = 1, select_last_index = 1>(columns)
  top = ArgMax<axis = 1, keepdims = 1>(lines)
  bottom = ArgMax<axis = 1, keepdims = 1, select_last_index = 1>(lines)
  x1 = Cast<to = 1>(left)
  x2 = Cast<to = 1>(right)
  y1 = Cast<to = 1>(top)
  y2 = Cast<to = 1>(bottom)
"""
"""Of a `mask` [1, 1, H, W], with `channels` = {1}: `most`, 1 if anything is true, and its x1, x2, y1, y2."""


def write_network(path: Path, text: str, **arrays: NDArray[np.float32]) -> Path:
    """Compiles the text form, with arrays that it names, checked by ONNX's own checker; the file's folder is made."""
    model = onnx.parser.parse_model(f'<ir_version: 8, opset_import: ["" : 17]>\n{text}')
    model.graph.initializer.extend(numpy_helper.from_array(array, name) for name, array in arrays.items())
    onnx.checker.check_model(model)
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, path)
    return path
