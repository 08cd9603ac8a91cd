"""Instruction sets, and gsplat's own front end where there is no GPU."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from fastsplat.service.splatting.raster import cuda
from fastsplat.service.splatting.raster.kernels import instruction_sets, running_with
from tests.splatting import gsplat_front_end


@pytest.fixture(params=instruction_sets())
def isa(request: pytest.FixtureRequest) -> Iterator[str]:
    """Each instruction set of this machine; the test runs with it."""
    with running_with(isa=request.param):
        yield request.param


@pytest.fixture
def gsplat_on_cpu(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Backend `cuda` on CPU tensors: everything of it, and of gsplat, but gsplat's kernels."""
    front_end = gsplat_front_end.install(monkeypatch)
    monkeypatch.setattr(cuda, "gsplat_module", lambda: front_end)
    monkeypatch.setattr(cuda, "DEVICE", "cpu")
    return front_end
