"""Networks of a few operations, written as ONNX's text form: stand-ins for models whose weights are not at hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import onnx.parser
from numpy.typing import NDArray
from onnx import numpy_helper


def write_network(path: Path, text: str, **arrays: NDArray[np.float32]) -> Path:
    """Compiles the text form, with arrays that it names, checked by ONNX's own checker; the file's folder is made."""
    model = onnx.parser.parse_model(f'<ir_version: 8, opset_import: ["" : 17]>\n{text}')
    model.graph.initializer.extend(numpy_helper.from_array(array, name) for name, array in arrays.items())
    onnx.checker.check_model(model)
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, path)
    return path
