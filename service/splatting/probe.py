"""How fast this machine is at what training does: a short measurement at the edge of `service.splatting.plan`."""

from __future__ import annotations

import time

import torch

from service.common.camera import Camera
from service.splatting.losses import image_loss
from service.splatting.raster import Backend, Splats, rasterize

REFERENCE_SECONDS = 0.0077
"""What one round takes on the reference machine, quiet."""

_FEWEST_ROUNDS, _SECONDS = 5, 0.5
_GAUSSIANS, _WIDTH, _HEIGHT = 8_000, 240, 180


def machine_speed(backend: Backend = "cpu") -> float:
    """Times as fast as the reference machine: 1 for it, 0.5 for one that takes twice as long. Takes half a second.

    A round is what a step is: 8,000 Gaussians with 11 channels drawn on 240×180 pixels, compared, and differentiated.
    The median round counts, so that other work on the machine slows the figure as it will slow the run.
    """
    splats, viewmat, target = _workload()
    camera = Camera(_WIDTH, _HEIGHT, 220.0, 220.0, _WIDTH / 2, _HEIGHT / 2)
    rounds: list[float] = []
    begun = time.monotonic()
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # as in training
    try:
        while len(rounds) < _FEWEST_ROUNDS or time.monotonic() - begun < _SECONDS:
            started = time.monotonic()
            image = rasterize(splats, viewmat, camera, backend=backend).image
            rgb, rest = torch.split(image, [3, image.shape[2] - 3], dim=2)
            loss = image_loss(rgb, target, 0.2, None) + rest.square().mean()
            loss.backward()  # type: ignore[no-untyped-call]
            rounds.append(time.monotonic() - started)
    finally:
        torch.set_num_threads(threads)
    return REFERENCE_SECONDS / sorted(rounds[1:])[len(rounds[1:]) // 2]


def _workload() -> tuple[Splats, torch.Tensor, torch.Tensor]:
    random = torch.Generator().manual_seed(0)
    means = torch.rand(_GAUSSIANS, 3, generator=random) * torch.tensor([2.0, 1.5, 2.0]) + torch.tensor(
        [-1.0, -0.75, 1.5]
    )
    parts = (
        means,
        torch.randn(_GAUSSIANS, 4, generator=random),
        torch.rand(_GAUSSIANS, 3, generator=random) * 0.03 + 0.005,
        torch.rand(_GAUSSIANS, generator=random) * 0.8 + 0.1,
        torch.rand(_GAUSSIANS, 11, generator=random),
    )
    target = torch.rand(_HEIGHT, _WIDTH, 3, generator=random)
    return Splats(*(part.requires_grad_() for part in parts)), torch.eye(4), target
