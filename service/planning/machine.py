"""Short benchmarks of this machine: training speed and perception cost."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from io import BytesIO

import cv2
import numpy as np
import torch
from PIL import Image

from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.perception.label_maps.labelling import label_capture
from fastsplat.service.perception.label_maps.side_by_side import side_by_side
from fastsplat.service.planning.cost_model import PerceptionCost, Speed
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.losses.functional import image_loss
from fastsplat.service.splatting.raster.image_formation import Backend, Splats
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat_contract.geometry.camera import Camera

_STEP_S, _IMAGE_S, _NETWORK_S = 0.0032, 0.00066, 0.0069
"""Reference CPU seconds per round, derived from whole jobs (`benchmarks.estimates`)."""

_FEWEST_ROUNDS, _SECONDS = 5, 0.4
_GAUSSIANS, _WIDTH, _HEIGHT = 8_000, 240, 180
_SEARCH_SHARE = 0.1  # detection time of a view, relative to segmentation


def machine_speed(backend: Backend = "cpu") -> Speed:
    """Measures speed relative to the reference machine, in one or two seconds.

    `steps` renders 8,000 Gaussians with loss and backward, `serial` decodes and downscales a photo, `networks` is a
    convolution and a matrix product. CPU time counts (wall time of steps on CUDA), as the load of this second says
    little about the next minutes; the result is slowed by the square root of wall over CPU time, half way between
    passing and lasting load.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # as in training; threads waiting for each other would count as busy
    try:
        network, network_wall = _mean(_network())
        step, step_wall = _mean(_step(backend))
        image, image_wall = _mean(_image())
    finally:
        torch.set_num_threads(threads)
    step = step_wall if backend == "cuda" else step
    alone = Speed(_STEP_S / step, _IMAGE_S / image, _NETWORK_S * threads / network)  # views run in parallel
    return alone.slowed(math.sqrt(max(1.0, (network_wall + image_wall) / (network + image))))


def perception_cost(capture: Capture, settings: Settings, labels: Sequence[str], progress: Progress) -> PerceptionCost:
    """Measures perception by labelling the capture's middle view; raises as `label_capture`."""
    one_view = replace(capture, views=(capture.views[len(capture.views) // 2],))
    times: list[float] = []

    def listen(event: ProgressEvent) -> None:
        times.append(time.monotonic())
        progress(replace(event, fraction=0.0))

    begun = time.monotonic()
    masks = settings.discovery.proposes(given_labels=capture.given_labels is not None)
    label_capture(one_view, settings.perception, settings.models, tuple(labels), listen, masks=masks)
    total = time.monotonic() - begun
    # The last event follows segmentation of the view, the one before follows model loading and detection.
    alone = times[-1] - times[-2]
    segment = alone / side_by_side(settings.perception)[0]
    search = _SEARCH_SHARE * segment
    return PerceptionCost(
        max(0.0, total - alone - search), search, segment, settings.perception.proposal_views if masks else 0
    )


def _mean(work: Callable[[], None]) -> tuple[float, float]:
    """Seconds per round: thread CPU time, wall time."""
    work()
    rounds, begun, cpu_begun = 0, time.monotonic(), time.thread_time()
    while rounds < _FEWEST_ROUNDS or time.monotonic() - begun < _SECONDS:
        work()
        rounds += 1
    return (time.thread_time() - cpu_begun) / rounds, (time.monotonic() - begun) / rounds


def _step(backend: Backend) -> Callable[[], None]:
    random = torch.Generator().manual_seed(0)
    place, size = torch.tensor([-1.0, -0.75, 1.5]), torch.tensor([2.0, 1.5, 2.0])
    parts = (
        torch.rand(_GAUSSIANS, 3, generator=random) * size + place,
        torch.randn(_GAUSSIANS, 4, generator=random),
        torch.rand(_GAUSSIANS, 3, generator=random) * 0.03 + 0.005,
        torch.rand(_GAUSSIANS, generator=random) * 0.8 + 0.1,
        torch.rand(_GAUSSIANS, 11, generator=random),
    )
    splats, viewmat = Splats(*(part.requires_grad_() for part in parts)), torch.eye(4)
    target = torch.rand(_HEIGHT, _WIDTH, 3, generator=random)
    camera = Camera(_WIDTH, _HEIGHT, 220.0, 220.0, _WIDTH / 2, _HEIGHT / 2)

    def step() -> None:
        image = rasterize(splats, viewmat, camera, backend=backend).image
        rgb, rest = torch.split(image, [3, image.shape[2] - 3], dim=2)
        loss = image_loss(rgb, target, 0.2, None) + rest.square().mean()
        loss.backward()

    return step


def _image() -> Callable[[], None]:
    noise = np.random.default_rng(0).integers(0, 256, (30, 40, 3), np.uint8)
    photo = cv2.imencode(".jpg", cv2.resize(noise, (640, 480), interpolation=cv2.INTER_CUBIC))[1].tobytes()

    def image() -> None:
        with Image.open(BytesIO(photo)) as opened:
            cv2.resize(np.asarray(opened.convert("RGB")), (320, 240), interpolation=cv2.INTER_AREA)

    return image


def _network() -> Callable[[], None]:
    random = torch.Generator().manual_seed(0)
    image, kernels = torch.rand(1, 64, 64, 64, generator=random), torch.rand(64, 64, 3, 3, generator=random)
    tokens, weight = torch.rand(1_024, 320, generator=random), torch.rand(320, 1_280, generator=random)

    @torch.inference_mode()
    def network() -> None:
        torch.nn.functional.conv2d(image, kernels, padding=1)
        torch.nn.functional.gelu(tokens @ weight)

    return network
