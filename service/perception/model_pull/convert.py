"""Conversion of model files to ONNX in a child process with its own packages."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from fastsplat.service.perception.model_pull.sources import run_pip
from fastsplat.service.perception.models.model_manifest import Conversion
from fastsplat_contract.errors import ModelUnavailableError

_TIMEOUT_S = 900
_SCRIPTS = {"paddle": "convert_paddle.py", "mobile_sam": "convert_mobile_sam.py"}


def convert(conversion: Conversion, carriers: Path, target: Path, *, packages: Path, name: str) -> None:
    """Converts the files in `carriers` and writes the result to `target`.

    The temporary folder `packages` keeps the conversion's packages out of the product's environment. Raises
    `ModelUnavailableError` with the end of the output if it fails.
    """
    if conversion.packages:
        arguments = ["install", "--no-deps", "--only-binary", ":all:", "--target", str(packages), *conversion.packages]
        try:
            run_pip(arguments, refuse=_PipFailedError)
        except _PipFailedError as error:
            raise ModelUnavailableError(
                f"model {name}: the packages for its conversion could not be installed: {error}",
                field=name,
                hint="Check the network and the package index.",
            ) from error
    script = Path(__file__).parent / _SCRIPTS[conversion.kind]
    # Scripts append the packages to their search path, so that they shadow none of the product's.
    command = [sys.executable, str(script), str(carriers), str(target), str(packages)]
    # The script's folder must not become importable: it holds modules of the product under bare names.
    environment = {**os.environ, "PYTHONSAFEPATH": "1"}
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False, env=environment)
        failure = done.stderr.strip() if done.returncode else ""
    except subprocess.TimeoutExpired:
        failure = f"no end after {_TIMEOUT_S} s"
    if failure:
        raise ModelUnavailableError(
            f"model {name}: its conversion failed: {' '.join(failure.splitlines()[-3:])[:400]}",
            field=name,
            hint="Convert it elsewhere and put the files into the model directory.",
        )


class _PipFailedError(Exception):
    pass
