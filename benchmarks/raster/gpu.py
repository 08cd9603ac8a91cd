"""`python -m benchmarks.raster.gpu`: parity with cpu, joint against RGB-only training, frames a second. Needs a GPU."""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from torch import Tensor

from benchmarks.provenance import MADE_FAST_HERE, begin, parser_of, write_results
from benchmarks.raster.garden import Scene, garden
from benchmarks.raster.product_step import step_milliseconds
from fastsplat.service.splatting.losses.functional import image_loss
from fastsplat.service.splatting.raster import cuda
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend, Splats
from fastsplat.service.splatting.raster.rendering import label_map, rasterize, sh_to_rgb
from fastsplat_contract.errors import ModelUnavailableError

_PARTS = ("means", "quats", "scales", "opacities", "features")
_LABELS, _CODE = 20, 8


@dataclass(frozen=True)
class Timing:
    """Milliseconds and the highest GPU memory of one kind of step, MiB."""

    what: str
    gaussians: int
    width: int
    height: int
    ms: float
    peak_mib: float


def main() -> None:
    """Measures and writes; refuses where there is no GPU."""
    parser = parser_of(__doc__)
    parser.add_argument("--rounds", type=int, default=50)
    parser.add_argument("--gaussians", type=int, default=100_000)
    arguments = parser.parse_args()
    try:
        device = device_of("cuda")
    except ModelUnavailableError as error:
        raise SystemExit(f"{error}; nothing was measured.") from error
    start = begin()
    report = measure(device, arguments.gaussians, arguments.rounds)
    write_results("gpu", start, arguments, MADE_FAST_HERE, {"gpu": torch.cuda.get_device_name(), **report})


def measure(device: torch.device, count: int, rounds: int, sizes: tuple[tuple[int, int], ...] = ()) -> dict[str, Any]:
    """Everything, as it goes into the report."""
    sizes = sizes or ((320, 240), (640, 480), (1920, 1080))
    small = garden(min(count, 20_000), *sizes[0], 6)
    parity = compare(small, device)
    print("relative L2 distance of cuda from cpu:", json.dumps(parity))
    scene = on_device(garden(count, *sizes[1], 3 + _CODE), device)
    steps = [joint_step(scene, rounds), timed("RGB-only training step, gsplat", scene, rgb_step(scene), rounds)]
    frames = [
        timed("label map", view, labels_of(view), rounds)
        for view in (on_device(garden(count, *size, _CODE), device) for size in sizes[1:])
    ]
    frames += [
        timed("colors and codes", view, picture_of(view), rounds)
        for view in (on_device(garden(count, *size, 3 + _CODE), device) for size in sizes[1:])
    ]
    for row in (*steps, *frames):
        print(f"{row.what:34} {row.gaussians:8} {row.width:5}×{row.height:<5} {row.ms:9.3f} ms {row.peak_mib:8.1f} MiB")
    ratios = {"time": steps[0].ms / steps[1].ms, "memory": steps[0].peak_mib / max(steps[1].peak_mib, 1e-9)}
    print("joint / RGB-only:", json.dumps(ratios))
    return {
        "scene": scene.source,
        "parity_relative_l2": parity,
        "training": [asdict(row) for row in steps],
        "joint_over_rgb_only": ratios,
        "rendering": [asdict(row) | {"frames_per_second": 1e3 / row.ms} for row in frames],
    }


def on_device(scene: Scene, device: torch.device) -> Scene:
    """The scene with its tensors on `device`."""
    splats = Splats(**{name: getattr(scene.splats, name).to(device) for name in _PARTS})
    return replace(scene, splats=splats, viewmat=scene.viewmat.to(device))


def compare(scene: Scene, device: torch.device) -> dict[str, float]:
    """Relative L2 distance of the GPU's image, alpha, depth and gradients from the CPU's."""
    camera, stretch = scene.camera, torch.tensor([1.0, 0.5, 0.25])  # round Gaussians would have no gradient of rotation
    scene = replace(scene, splats=replace(scene.splats, scales=scene.splats.scales * stretch))
    grad = torch.randn(camera.height, camera.width, 6, generator=torch.Generator().manual_seed(0))
    measured: list[dict[str, Tensor]] = []
    backends: tuple[Backend, Backend] = ("cpu", "cuda")
    for backend, place in zip(backends, (torch.device("cpu"), device), strict=True):
        parts = {n: getattr(scene.splats, n).to(place, copy=True).requires_grad_() for n in _PARTS}
        out = rasterize(Splats(**parts), scene.viewmat.to(place), camera, backend=backend)
        (out.image * grad.to(place)).sum().backward()
        values = {"image": out.image, "alpha": out.alpha, "depth": out.depth}
        values |= {f"d_{name}": part.grad for name, part in parts.items() if part.grad is not None}
        measured.append({name: value.detach().cpu().double() for name, value in values.items()})
    ours, theirs = measured
    return {name: float((theirs[name] - ours[name]).norm() / ours[name].norm().clamp_min(1e-300)) for name in ours}


def joint_step(scene: Scene, rounds: int) -> Timing:
    """The product's own training step, its mean over `rounds`."""
    gpu = scene.viewmat.device.type == "cuda"
    if gpu:
        torch.cuda.reset_peak_memory_stats()
    milliseconds = step_milliseconds(scene, _LABELS, rounds, "cuda")
    peak = torch.cuda.max_memory_allocated() / 2**20 if gpu else 0.0
    camera = scene.camera
    return Timing("joint training step, ours", len(scene.splats.means), camera.width, camera.height, milliseconds, peak)


def timed(what: str, scene: Scene, action: Callable[[], object], rounds: int) -> Timing:
    """The median over `rounds`, after five to warm up."""
    gpu = scene.viewmat.device.type == "cuda"
    for _ in range(5):
        action()
    if gpu:
        torch.cuda.reset_peak_memory_stats()
    times = []
    for _ in range(rounds):
        if gpu:
            torch.cuda.synchronize()
        start = time.perf_counter()
        action()
        if gpu:
            torch.cuda.synchronize()
        times.append((time.perf_counter() - start) * 1e3)
    peak = torch.cuda.max_memory_allocated() / 2**20 if gpu else 0.0
    camera = scene.camera
    return Timing(what, len(scene.splats.means), camera.width, camera.height, statistics.median(times), peak)


def rgb_step(scene: Scene) -> Callable[[], None]:
    """What a user of gsplat writes: its rasterizer, L1 + D-SSIM, torch's Adam; colors of first-degree harmonics."""
    kernels, device = cuda.gsplat_module(), scene.viewmat.device
    g, camera, splats = torch.Generator().manual_seed(1), scene.camera, scene.splats
    count = len(splats.means)
    sh = (torch.rand(count, 4, 3, generator=g) - 0.5).to(device)
    values = (splats.means, splats.quats, splats.scales.log(), torch.logit(splats.opacities), sh)
    means, quats, log_scales, logits, sh = (value.clone().requires_grad_() for value in values)
    optimizer = torch.optim.Adam([means, quats, log_scales, logits, sh], lr=1e-7, eps=1e-15)
    target = torch.rand(camera.height, camera.width, 3, generator=g).to(device)
    rows = ((camera.fx, 0.0, camera.cx), (0.0, camera.fy, camera.cy), (0.0, 0.0, 1.0))
    intrinsics = torch.tensor(rows, device=device)[None]
    viewmat = scene.viewmat.float()
    position = -viewmat[:3, :3].T @ viewmat[:3, 3]

    def step() -> None:
        pictures, _, _ = kernels.rasterization(
            means,
            quats,
            log_scales.exp(),
            torch.sigmoid(logits),
            sh_to_rgb(means, sh, position, 1, backend="cuda"),
            viewmat[None],
            intrinsics,
            camera.width,
            camera.height,
            near_plane=0.01,
            far_plane=1e10,
            eps2d=0.3,
            packed=False,
            render_mode="RGB+D",
            rasterize_mode="classic",
        )
        image_loss(pictures[0, ..., :3], target, 0.2).backward()
        optimizer.step()
        optimizer.zero_grad()

    return step


def labels_of(scene: Scene) -> Callable[[], object]:
    """A label map of 18 classes."""
    g = torch.Generator().manual_seed(2)
    weight, bias = (torch.randn(*shape, generator=g).to(scene.viewmat.device) for shape in ((18, _CODE), (18,)))
    return lambda: (
        label_map(scene.splats, scene.viewmat, scene.camera, weight, bias, alpha_min=0.5, backend="cuda").classes
    )


def picture_of(scene: Scene) -> Callable[[], object]:
    """Colours and codes in one picture, without gradients."""
    return lambda: rasterize(scene.splats, scene.viewmat, scene.camera, backend="cuda").image


if __name__ == "__main__":
    main()
