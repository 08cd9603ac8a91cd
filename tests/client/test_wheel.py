"""The client alone: its wheel brings little, and importing it loads nothing of the service."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.client.wheel import build_wheel, make_environment

_MOST_BYTES = 140 * 10**6  # numpy and grpc are nine tenths of it
_FORBIDDEN = ("torch", "cv2", "PIL", "scipy", "pycolmap", "fastsplat", "google.rpc", "grpc_status")
_IMPORT = """
import json, sys
import fastsplat_client
json.dump(sorted(sys.modules), sys.stdout)
"""
_PNG = """
from fastsplat_client import MissingPackageError, ViewMask
try:
    ViewMask("", 0, None, b"png", 3).array()
except MissingPackageError as error:
    print(error.reason, error.hint)
"""


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment with the client and nothing else."""
    folder = tmp_path_factory.mktemp("client")
    return make_environment(sys.executable, folder / "venv", build_wheel(folder))


def _output(python: Path, code: str) -> str:
    done = subprocess.run([python, "-I", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_its_environment_is_small(python: Path) -> None:
    (packages,) = (python.parent.parent / "lib").glob("python3.*/site-packages")
    size = sum(path.stat().st_size for path in packages.rglob("*") if path.is_file() and not path.is_symlink())
    assert (packages / "numpy").is_dir() and (packages / "pip").is_dir()
    assert size <= _MOST_BYTES, f"{size / 1e6:.0f} MB"


def test_importing_it_loads_nothing_of_the_service(python: Path) -> None:
    loaded = json.loads(_output(python, _IMPORT))
    assert "fastsplat_contract.messages.queries" in loaded
    assert [name for name in loaded for top in _FORBIDDEN if f"{name}.".startswith(f"{top}.")] == []


def test_a_png_mask_says_what_it_needs(python: Path) -> None:
    message = _output(python, _PNG)
    assert message.startswith("MISSING_PACKAGE") and "fastsplat-client[png]" in message


def test_everything_that_is_public_is_there(python: Path) -> None:
    code = "import fastsplat_client as c; print(all(hasattr(c, name) for name in c.__all__))"
    assert _output(python, code).strip() == "True"
