"""How fast this machine is at what training does: a short measurement at the edge of `service.splatting.plan`."""

from __future__ import annotations

import time
from collections.abc import Callable
from io import BytesIO

import cv2
import numpy as np
import torch
from PIL import Image

from fastsplat.service.splatting.losses import image_loss
from fastsplat.service.splatting.plan import Speed
from fastsplat.service.splatting.raster import Backend, Splats, rasterize
from fastsplat_contract.camera import Camera

_STEP_S, _IMAGE_S = 0.0077, 0.0030
"""What a round of each kind takes on the reference machine, quiet."""

_FEWEST_ROUNDS, _SECONDS = 5, 0.4
_GAUSSIANS, _WIDTH, _HEIGHT = 8_000, 240, 180


def machine_speed(backend: Backend = "cpu") -> Speed:
    """Against the reference machine. Takes a second.

    A round of `steps` is what an optimisation step is: 8,000 Gaussians with 11 channels drawn on 240×180 pixels,
    compared, and differentiated. A round of `serial` decodes and reduces a photo of 640×480. Means count, so that
    other work on the machine slows the figures as it will slow the run.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # as in training
    try:
        return Speed(_STEP_S / _mean(_step(backend)), _IMAGE_S / _mean(_image()))
    finally:
        torch.set_num_threads(threads)


def _mean(work: Callable[[], None]) -> float:
    work()
    rounds, begun = 0, time.monotonic()
    while rounds < _FEWEST_ROUNDS or time.monotonic() - begun < _SECONDS:
        work()
        rounds += 1
    return (time.monotonic() - begun) / rounds


def _step(backend: Backend) -> Callable[[], None]:
    splats, viewmat, target = _workload()
    camera = Camera(_WIDTH, _HEIGHT, 220.0, 220.0, _WIDTH / 2, _HEIGHT / 2)

    def step() -> None:
        image = rasterize(splats, viewmat, camera, backend=backend).image
        rgb, rest = torch.split(image, [3, image.shape[2] - 3], dim=2)
        loss = image_loss(rgb, target, 0.2, None) + rest.square().mean()
        loss.backward()  # type: ignore[no-untyped-call]

    return step


def _image() -> Callable[[], None]:
    noise = np.random.default_rng(0).integers(0, 256, (30, 40, 3), np.uint8)
    photo = cv2.imencode(".jpg", cv2.resize(noise, (640, 480), interpolation=cv2.INTER_CUBIC))[1].tobytes()

    def image() -> None:
        with Image.open(BytesIO(photo)) as opened:
            cv2.resize(np.asarray(opened.convert("RGB")), (320, 240), interpolation=cv2.INTER_AREA)

    return image


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
