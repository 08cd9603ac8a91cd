"""Conversions: carrier files to ONNX, in a child process with packages that the product does not install."""

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
    """Fill `target` with what the conversion makes of the files in `carriers`.

    Args:
        packages: temporary folder that the packages are installed into, never the product's environment.

    Raises:
        ModelUnavailableError: a package or the conversion failed; has its last words.
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
    # Scripts put the packages at the end of their own search path, so that these shadow nothing of the product's.
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
