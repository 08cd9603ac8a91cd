"""Child process: a Paddle inference model to ONNX. Usage: convert_paddle.py CARRIERS TARGET PACKAGES.

Only the compiled part of paddle2onnx is loaded, as its Python part imports all of PaddlePaddle.
"""

from __future__ import annotations

import sys
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

_OPSET = 16


def _main(carriers: Path, target: Path, packages: Path) -> None:
    name = "paddle2onnx_cpp2py_export"
    (library,) = (packages / "paddle2onnx").glob(f"{name}*.so")
    spec = spec_from_loader(name, loader := ExtensionFileLoader(name, str(library)))
    assert spec is not None
    converter = module_from_spec(spec)
    loader.exec_module(converter)
    (program,) = carriers.glob("*.pdmodel")
    onnx = converter.export(
        str(program), str(program.with_suffix(".pdiparams")),
        _OPSET, True, False, True, True, True,  # opset, may rise, quiet, checked, experimental operators, optimised
        {}, "onnxruntime", "", "", False,  # no custom operators, backend, no calibration, one file, not half precision
    )  # fmt: skip
    (target / "picodet_416.onnx").write_bytes(onnx)


if __name__ == "__main__":
    _main(*map(Path, sys.argv[1:4]))
