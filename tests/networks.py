"""Networks of a few operations, written as ONNX's text form: stand-ins for models whose weights are not at hand."""

from __future__ import annotations

from pathlib import Path

import onnx
import onnx.parser


def write_network(path: Path, text: str) -> Path:
    """Compiles the text form, checked by ONNX's own checker, into a file whose folder is made."""
    model = onnx.parser.parse_model(f'<ir_version: 8, opset_import: ["" : 17]>\n{text}')
    onnx.checker.check_model(model)
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, path)
    return path
