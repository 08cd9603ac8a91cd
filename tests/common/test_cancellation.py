"""Work that nobody waits for stops, down to the compiled rasterizer."""

from __future__ import annotations

import threading

import pytest
import torch

from fastsplat.service.common.cancellation import Cancellation, cancellable, check_cancelled
from fastsplat.service.splatting.raster.image_formation import Splats
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat_contract.errors import CancelledError
from fastsplat_contract.geometry.camera import Camera


def test_only_the_call_that_was_cancelled_stops() -> None:
    mine, theirs = Cancellation(), Cancellation()
    mine.cancel()
    check_cancelled()
    with cancellable(theirs):
        check_cancelled()
        with cancellable(mine), pytest.raises(CancelledError):
            check_cancelled()
        check_cancelled()


def test_a_flag_is_seen_by_its_own_thread_alone() -> None:
    cancellation = Cancellation()
    cancellation.cancel()
    with cancellable(cancellation):
        thread = threading.Thread(target=check_cancelled)
        thread.start()
        thread.join()
        with pytest.raises(CancelledError):
            check_cancelled()


def test_a_long_rendering_stops_in_the_middle_and_the_next_one_is_whole() -> None:
    rng = torch.Generator().manual_seed(0)
    count = 20_000  # thin fog over two megapixels: every Gaussian touches most tiles, so this takes long
    splats = Splats(
        means=torch.randn(count, 3, generator=rng) + torch.tensor([0.0, 0.0, 6.0]),
        quats=torch.randn(count, 4, generator=rng),
        scales=torch.full((count, 3), 0.5),
        opacities=torch.full((count,), 0.006),
        features=torch.rand(count, 3, generator=rng),
    )
    camera = Camera(1600, 1200, 1200.0, 1200.0, 800.0, 600.0)
    cancellation = Cancellation()
    cancellation.cancel()
    with cancellable(cancellation), pytest.raises(CancelledError):
        rasterize(splats, torch.eye(4), camera)
    small = camera.scaled_to(64, 48)
    assert rasterize(splats, torch.eye(4), small).alpha.max() > 0.5
