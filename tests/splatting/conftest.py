"""Instruction sets."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from fastsplat.service.splatting.raster.kernels import instruction_sets, running_with


@pytest.fixture(params=instruction_sets())
def isa(request: pytest.FixtureRequest) -> Iterator[str]:
    """Each instruction set of this machine; the test runs with it."""
    with running_with(isa=request.param):
        yield request.param
