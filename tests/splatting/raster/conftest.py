"""The scenes live beside the tests; pytest's importlib mode does not put this folder on the path by itself."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from fastsplat.service.splatting.raster.image_formation import Backend

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(params=["reference", "cpu", "cuda"])
def backend(request: pytest.FixtureRequest) -> Backend:
    """Each backend; `cuda` on the CPU."""
    if request.param == "cuda":
        request.getfixturevalue("gsplat_on_cpu")
    return request.param
