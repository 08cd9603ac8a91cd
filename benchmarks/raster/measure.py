"""Medians of forward, backward and a whole training step; one row of the table each."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

from benchmarks.raster.scenes import Scene
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.losses import image_loss, semantic_loss
from fastsplat.service.splatting.optim import adam_update
from fastsplat.service.splatting.raster import Backend, RasterSettings, Splats, cpu, label_map, rasterize, sh_to_rgb
from fastsplat.service.splatting.raster.kernels import kernels, running_with

# Arithmetic vector instructions per visit of a block, from rasterize_forward.cpp and rasterize_backward.cpp: exponent,
# 2^x, blending; per channel.
_FORWARD = (16, 1)
_BACKWARD = (30, 2)


@dataclass(frozen=True)
class Row:
    """One line of the table; times in milliseconds, `floor_ratio` = measured / (useful lanes × operations / peak)."""

    backend: str
    isa: str
    threads: int
    gaussians: int
    width: int
    height: int
    channels: int
    forward_ms: float | None
    backward_ms: float | None
    step_ms: float | None
    floor_ratio: float | None
    stages_ms: dict[str, float] = field(default_factory=dict)
    label_map_ms: float | None = None


def raster_row(scene: Scene, isa: str, threads: int, *, backward: bool = True, rounds: int = 15) -> Row:
    """Forward, and backward from a gradient of the image, through autograd as a caller sees it."""
    parts = [getattr(scene.splats, name) for name in ("means", "quats", "scales", "opacities", "features")]
    tensors = [part.clone().requires_grad_(backward) for part in parts]
    camera, channels = scene.camera, parts[4].shape[1]
    grad = torch.randn(camera.height, camera.width, channels, generator=torch.Generator().manual_seed(0))
    forwards, backwards, stages = [], [], []
    with running_with(isa=isa, threads=threads):
        for _ in range(rounds + 3):
            for tensor in tensors:
                tensor.grad = None
            start = time.perf_counter()
            rendering, context = cpu.rasterize_with_context(
                Splats(*tensors), scene.viewmat, camera, None, RasterSettings()
            )
            middle = time.perf_counter()
            if backward:
                rendering.image.backward(grad)
            end = time.perf_counter()
            forwards.append((middle - start) * 1e3)
            backwards.append((end - middle) * 1e3)
            stages.append(context.milliseconds)
        useful = kernels.count_contributing(context)
        rate, lanes = kernels.peak_fma(threads, isa)
    forward_ms, backward_ms = statistics.median(forwards[3:]), statistics.median(backwards[3:])
    operations = _FORWARD[0] + _FORWARD[1] * (channels + 1)
    operations += (_BACKWARD[0] + _BACKWARD[1] * (channels + 1)) if backward else 0
    floor_ms = useful / lanes * operations / rate * 1e-6
    total = forward_ms + (backward_ms if backward else 0.0)
    return Row(
        "cpu",
        isa,
        threads,
        len(parts[0]),
        camera.width,
        camera.height,
        channels,
        round(forward_ms, 3),
        round(backward_ms, 3) if backward else None,
        None,
        round(total / floor_ms, 2) if floor_ms else None,
        {name: round(statistics.median(stage[name] for stage in stages[3:]), 3) for name in stages[0]},
    )


def step_row(scene: Scene, isa: str, threads: int, labels: int = 20, rounds: int = 15) -> Row:
    """One whole training step: activations, harmonics, rasterizer, both losses, backward, Adam on every parameter."""
    step = training_step(scene, labels)
    with running_with(isa=isa, threads=threads):
        for _ in range(3):
            step()
        times = [_timed(step) for _ in range(rounds)]
    camera = scene.camera
    return Row(
        "cpu",
        isa,
        threads,
        len(scene.splats.means),
        camera.width,
        camera.height,
        scene.splats.features.shape[1],
        None,
        None,
        round(statistics.median(times), 3),
        None,
    )


def label_row(scene: Scene, isa: str, threads: int, classes: int = 18, rounds: int = 15) -> Row:
    """A label map of the scene, its features being codes; without gradients, from tensors to classes."""
    g = torch.Generator().manual_seed(2)
    camera, channels = scene.camera, scene.splats.features.shape[1]
    weight, bias = torch.randn(classes, channels, generator=g), torch.randn(classes, generator=g)

    def draw() -> None:
        label_map(scene.splats, scene.viewmat, camera, weight, bias, alpha_min=0.5)

    with running_with(isa=isa, threads=threads):
        for _ in range(3):
            draw()
        times = [_timed(draw) for _ in range(rounds)]
    return Row(
        "cpu",
        isa,
        threads,
        len(scene.splats.means),
        camera.width,
        camera.height,
        channels,
        None,
        None,
        None,
        None,
        label_map_ms=round(statistics.median(times), 3),
    )


def _timed(action: Callable[[], None]) -> float:
    start = time.perf_counter()
    action()
    return (time.perf_counter() - start) * 1e3


def training_step(scene: Scene, labels: int, backend: Backend = "cpu") -> Callable[[], None]:
    """One whole training step of a joint run, on the device of the scene's tensors."""
    device = scene.viewmat.device
    g = torch.Generator().manual_seed(1)
    splats, camera = scene.splats, scene.camera
    count, code = len(splats.means), splats.features.shape[1] - 3
    parameters = {
        "means": splats.means.clone(),
        "quats": splats.quats.clone(),
        "log_scales": splats.scales.log(),
        "logit_opacities": torch.logit(splats.opacities),
        "sh": torch.rand(count, 4, 3, generator=g) - 0.5,
        "codes": torch.randn(count, code, generator=g),
        "weight": torch.randn(labels + 1, code, generator=g),
        "bias": torch.zeros(labels + 1),
    }
    parameters = {name: value.to(device) for name, value in parameters.items()}
    exp_avg = {name: torch.zeros_like(value) for name, value in parameters.items()}
    exp_avg_sq = {name: torch.zeros_like(value) for name, value in parameters.items()}
    target = torch.rand(camera.height, camera.width, 3, generator=g).to(device)
    truth = torch.randint(0, labels + 1, (camera.height, camera.width), generator=g, dtype=torch.int32).to(device)
    class_weights = torch.ones(labels + 1, device=device)
    position = -scene.viewmat[:3, :3].T @ scene.viewmat[:3, 3]
    done = [0]

    def step() -> None:
        p: dict[str, Tensor] = {name: value.detach().requires_grad_() for name, value in parameters.items()}
        colours = sh_to_rgb(p["means"], p["sh"], position.float(), 1, backend=backend)
        features = torch.cat((colours, p["codes"]), dim=1)
        drawn = splats_of(p, features)
        rgb, codes = torch.split(rasterize(drawn, scene.viewmat, camera, backend=backend).image, [3, code], dim=2)
        loss = image_loss(rgb, target, 0.2)
        loss = loss + semantic_loss(codes, p["weight"], p["bias"], truth, class_weights)
        loss.backward()
        done[0] += 1
        for name, value in parameters.items():
            grad = p[name].grad
            assert grad is not None
            adam_update(value, grad, exp_avg[name], exp_avg_sq[name], lr=1e-7, step=done[0], backend=backend)

    return step
