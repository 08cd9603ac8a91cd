"""The client alone: its wheel brings little, and what it declares is enough to import all of it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.client.wheel import build_wheel, make_environment

_MOST_BYTES = 140 * 10**6  # numpy and grpc are nine tenths of it
_FORBIDDEN = {
    "fastsplat_contract": ("httpx", "grpc", "fastsplat_client"),
    "fastsplat_client": ("torch", "cv2", "PIL", "scipy", "pycolmap", "fastsplat", "google.rpc", "grpc_status"),
}
_IMPORT = """
import importlib, json, pkgutil, sys
loaded = {}
for package in sys.argv[1:]:
    for _, name, _ in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
        if not name.endswith("_grpc") and ".assistant" not in name:  # which an extra brings
            importlib.import_module(name)
    loaded[package] = sorted(sys.modules)
json.dump(loaded, sys.stdout)
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


def _output(python: Path, code: str, *words: str) -> str:
    done = subprocess.run([python, "-I", "-c", code, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_its_environment_is_small(python: Path) -> None:
    (packages,) = (python.parent.parent / "lib").glob("python3.*/site-packages")
    size = sum(path.stat().st_size for path in packages.rglob("*") if path.is_file() and not path.is_symlink())
    assert (packages / "numpy").is_dir() and (packages / "pip").is_dir()
    assert size <= _MOST_BYTES, f"{size / 1e6:.0f} MB"


def test_all_of_it_is_imported_without_the_service_and_the_contract_without_the_network(python: Path) -> None:
    for package, loaded in json.loads(_output(python, _IMPORT, *_FORBIDDEN)).items():
        assert "fastsplat_contract.messages.queries" in loaded
        assert [name for name in loaded for top in _FORBIDDEN[package] if f"{name}.".startswith(f"{top}.")] == []


def test_a_png_mask_says_what_it_needs(python: Path) -> None:
    message = _output(python, _PNG)
    assert message.startswith("MISSING_PACKAGE") and "fastsplat-client[png]" in message
