"""Medians of forward, backward and label maps; one row of the table each."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import torch

from benchmarks.raster.garden import Scene
from fastsplat.service.splatting.raster import cpu
from fastsplat.service.splatting.raster.image_formation import RasterSettings, Splats
from fastsplat.service.splatting.raster.kernels import kernels, running_with
from fastsplat.service.splatting.raster.rendering import label_map

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
