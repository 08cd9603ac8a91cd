"""A long call into the kernels can be left."""

from __future__ import annotations

import signal
from types import FrameType

import pytest
import torch

from fastsplat.service.splatting.raster import Rendering, Splats, rasterize
from fastsplat.service.splatting.raster.kernels import running_with
from fastsplat_contract.camera import Camera


class _StopError(Exception):
    pass


def _stop(signum: int, frame: FrameType | None) -> None:
    raise _StopError


def test_a_signal_handler_that_raises_ends_the_call_and_the_next_one_works() -> None:
    count = 600
    means = torch.zeros(count, 3)
    means[:, 2] = torch.linspace(2.0, 3.0, count)
    blankets = Splats(
        means,
        torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        torch.full((count, 3), 1e3),
        torch.full((count,), 0.005),
        torch.ones(count, 16),
    )
    result: Rendering | None = None
    before = signal.signal(signal.SIGALRM, _stop)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(_StopError), running_with(isa="baseline"):
            result = rasterize(blankets, torch.eye(4), Camera(1600, 1600, 1600.0, 1600.0, 800.0, 800.0))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert result is None  # the call itself was left, not the line after it
    small = rasterize(blankets, torch.eye(4), Camera(8, 8, 8.0, 8.0, 4.0, 4.0))
    assert float(small.alpha.min()) > 0.9
