"""Fixtures that point at data and weights outside the repository, through settings alone."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def _folder(variable: str, what: str) -> Path:
    value = os.environ.get(variable, "")
    if not value:
        pytest.skip(f"{variable} is not set: {what}")
    path = Path(value).resolve()
    if not path.is_dir():
        pytest.fail(f"{variable}={value} is not a folder")
    return path


@pytest.fixture(scope="session")
def test_data() -> Path:
    """The folder of benchmark data sets (tabletop, plush, kitchen, skull, garden)."""
    return _folder("FASTSPLAT_TEST_DATA", "the benchmark data sets are needed")


@pytest.fixture(scope="session")
def models_dir() -> Path:
    """The model directory with real weights."""
    return _folder("FASTSPLAT_MODELS", "a model directory with real weights is needed")
