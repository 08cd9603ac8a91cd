"""The C++ backend: torch.autograd around kernels that read and write torch's memory in place.

Environment: FASTSPLAT_RASTER_THREADS (default: the CPUs this process may use) and FASTSPLAT_RASTER_ISA (avx512, avx2 or
baseline; default: the best this machine has). The threads are the kernels' own; results do not depend on their number.
"""

from __future__ import annotations

import os
from typing import Any

import torch
from torch import Tensor

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.splatting.raster import classify
from fastsplat.service.splatting.raster.reference import pair_bound_error
from fastsplat.service.splatting.raster.types import LabelMap, LabelSums, RasterSettings, Rendering, Splats
from fastsplat_contract.camera import Camera
from fastsplat_contract.errors import CancelledError, InvalidInputError, ModelUnavailableError

try:
    from fastsplat.service.splatting.raster import _cpu
except ImportError as error:  # pragma: no cover - only in a checkout that was not built
    raise ModelUnavailableError(
        "the compiled rasterizer is missing", hint="Install the package: pip install -e . --no-build-isolation"
    ) from error

_cpu.watch(check_cancelled)

kernels = _cpu
"""The compiled module, for the losses and the optimiser as well."""


def thread_count() -> int:
    """Threads of the next call."""
    text = os.environ.get("FASTSPLAT_RASTER_THREADS", "")
    if not text:
        return min(64, len(os.sched_getaffinity(0)))
    if not text.isdigit() or not 1 <= int(text) <= 256:
        raise InvalidInputError(
            f"FASTSPLAT_RASTER_THREADS={text!r}", field="FASTSPLAT_RASTER_THREADS", limit="1..256 threads"
        )
    return int(text)


def instruction_set() -> str:
    """Kernels of the next call, one of `instruction_sets()`."""
    name = os.environ.get("FASTSPLAT_RASTER_ISA", "")
    if name and name not in kernels.isas():
        raise InvalidInputError(
            f"FASTSPLAT_RASTER_ISA={name!r} cannot run here",
            field="FASTSPLAT_RASTER_ISA",
            hint=f"Choose one of {', '.join(kernels.isas())}, or leave it unset.",
        )
    return name or str(kernels.isas()[0])


def instruction_sets() -> tuple[str, ...]:
    """What this machine can run, best first."""
    return tuple(kernels.isas())


def rasterize(
    splats: Splats, viewmat: Tensor, camera: Camera, background: Tensor | None, settings: RasterSettings
) -> Rendering:
    """See `service.splatting.raster.rasterize`. Computes in float32 (doubles once per Gaussian)."""
    return rasterize_with_frame(splats, viewmat, camera, background, settings)[0]


def rasterize_with_frame(
    splats: Splats, viewmat: Tensor, camera: Camera, background: Tensor | None, settings: RasterSettings
) -> tuple[Rendering, Any]:
    """As `rasterize`, and the kernels' own record of the call: visible, pairs, milliseconds of each stage."""
    dtype = splats.means.dtype
    parts = [_float32(part) for part in _parts(splats)]
    back = torch.zeros(parts[4].shape[1]) if background is None else _float32(background)
    info: dict[str, Any] = {}
    image, alpha, depth, median, radii = _Rasterize.apply(*parts, back, viewmat, camera, settings, info)  # type: ignore[no-untyped-call]
    if dtype != torch.float32:
        image, alpha, depth, median = (part.to(dtype) for part in (image, alpha, depth, median))
    frame = info["frame"]
    return Rendering(image, alpha, depth, median, radii, int(frame.culled_non_finite)), frame


def blend_sums(splats: Splats, viewmat: Tensor, camera: Camera, values: Tensor, settings: RasterSettings) -> Tensor:
    """See `service.splatting.raster.blend_sums`."""
    parts = [_float32(part.detach()) for part in _parts(splats)]
    frame, _ = _prepare(parts, viewmat, camera, settings)
    sums = torch.zeros(len(parts[0]), values.shape[-1])
    if sums.numel():
        _guard(
            settings, frame.blend, _float32(values.detach()).numpy(), sums.numpy(), thread_count(), instruction_set()
        )
    return sums.to(splats.means.dtype)


def label_map(
    splats: Splats,
    viewmat: Tensor,
    camera: Camera,
    weight: Tensor,
    bias: Tensor,
    alpha_min: float,
    relevancy: Tensor | None,
    settings: RasterSettings,
) -> LabelMap:
    """See `service.splatting.raster.label_map`."""
    parts = [_float32(part.detach()) for part in _parts(splats)]
    channels, size = parts[4].shape[1], weight.shape[1]
    if channels > kernels.MAX_GROUP:
        seen = rasterize(Splats(*parts), viewmat.detach(), camera, None, settings)
        return classify.label_map(seen, weight, bias, alpha_min, relevancy)
    frame, _ = _prepare(parts, viewmat, camera, settings)
    shape = (camera.height, camera.width)
    classes, alpha = torch.empty(shape, dtype=torch.int32), torch.empty(shape)
    expected = None if relevancy is None else torch.empty(shape)
    image = torch.empty(*shape, channels - size)
    optional = [None if part is None else _float32(part.detach()).numpy() for part in (relevancy, expected)]
    _guard(
        settings,
        frame.label_map,
        _float32(weight.detach()).numpy(),
        _float32(bias.detach()).numpy(),
        optional[0],
        alpha_min,
        classes.numpy(),
        alpha.numpy(),
        optional[1],
        image.numpy(),
        thread_count(),
        instruction_set(),
    )
    dtype = splats.means.dtype
    expected = None if expected is None else expected.to(dtype)
    return LabelMap(classes, alpha.to(dtype), expected, image.to(dtype), int(frame.culled_non_finite))


def label_sums(splats: Splats, viewmat: Tensor, camera: Camera, labels: Tensor, settings: RasterSettings) -> LabelSums:
    """See `service.splatting.raster.label_sums`."""
    parts = [_float32(part.detach()) for part in _parts(splats)]
    if labels.device.type != "cpu":
        raise InvalidInputError(f"the cpu backend got labels on {labels.device}", field="labels")
    frame, _ = _prepare(parts, viewmat, camera, settings)
    starts = torch.empty(len(parts[0]) + 1, dtype=torch.int64)
    wanted = labels.clamp(min=-1).to(torch.int32).contiguous().numpy()
    count = _guard(
        settings, frame.label_sums, wanted, settings.max_pairs, starts.numpy(), thread_count(), instruction_set()
    )
    found, sums = torch.empty(count, dtype=torch.int32), torch.empty(count, dtype=torch.float64)
    frame.label_entries(starts.numpy(), found.numpy(), sums.numpy())
    return LabelSums(starts, found, sums)


def sh_to_rgb(means: Tensor, sh: Tensor, camera_position: Tensor, degree: int) -> Tensor:
    """See `service.splatting.raster.sh_to_rgb`; float32."""
    rgb: Tensor = _Harmonics.apply(_float32(means), _float32(sh), _float32(camera_position.detach()), degree)  # type: ignore[no-untyped-call]
    return rgb


def _parts(splats: Splats) -> tuple[Tensor, ...]:
    return splats.means, splats.quats, splats.scales, splats.opacities, splats.features


def _float32(tensor: Tensor) -> Tensor:
    if tensor.device.type != "cpu":
        raise InvalidInputError(f"the cpu backend got a tensor on {tensor.device}", field="backend")
    return tensor.to(torch.float32).contiguous()


def _prepare(parts: list[Tensor], viewmat: Tensor, camera: Camera, settings: RasterSettings) -> tuple[Any, Tensor]:
    radii = torch.empty(len(parts[0]), dtype=torch.int32)
    lens = [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]
    limits = [
        settings.alpha_min,
        settings.alpha_max,
        settings.transmittance_min,
        settings.near,
        settings.far,
        settings.eps2d,
    ]
    pose = viewmat.detach().to(torch.float64).contiguous().numpy()
    arrays = [part.numpy() for part in parts]
    frame = _guard(
        settings,
        kernels.prepare,
        *arrays,
        pose,
        lens,
        limits,
        settings.max_pairs,
        radii.numpy(),
        thread_count(),
        instruction_set(),
    )
    return frame, radii


def _guard(settings: RasterSettings, call: Any, *arguments: Any) -> Any:
    try:
        return call(*arguments)
    except kernels.TooManyPairs:
        raise pair_bound_error(settings.max_pairs) from None
    except kernels.Cancelled:
        raise CancelledError("the rendering was cancelled") from None


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[Tensor, ...]:
        *tensors, viewmat, camera, settings, info = inputs
        parts = [tensor.detach() for tensor in tensors[:5]]
        background = tensors[5].detach()
        frame, radii = _prepare(parts, viewmat, camera, settings)
        shape = (camera.height, camera.width)
        image = torch.empty(*shape, parts[4].shape[1])
        alpha, depth, median = torch.empty(shape), torch.empty(shape), torch.empty(shape)
        arrays = [part.numpy() for part in (background, image, alpha, depth, median)]
        _guard(settings, frame.forward, *arrays, thread_count(), instruction_set())
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(median, radii)
        ctx.save_for_backward(*tensors, alpha)
        ctx.frame, ctx.settings, ctx.pose_dtype = frame, settings, viewmat.dtype
        info["frame"] = frame
        return image, alpha, depth, median, radii

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *grads: Any) -> tuple[Tensor | None, ...]:
        *tensors, alpha = ctx.saved_tensors
        outputs = [None if grad is None else grad.contiguous().numpy() for grad in grads[:3]]
        parts = [tensor.detach() for tensor in tensors[:5]]
        gradients = [torch.empty_like(part) for part in parts]
        pose = torch.empty(12, dtype=torch.float64) if ctx.needs_input_grad[6] else None
        _guard(
            ctx.settings,
            ctx.frame.backward,
            *(part.numpy() for part in parts),
            tensors[5].detach().numpy(),
            *outputs,
            *(gradient.numpy() for gradient in gradients),
            None if pose is None else pose.numpy(),
            thread_count(),
            instruction_set(),
        )
        back = None
        if ctx.needs_input_grad[5] and grads[0] is not None:
            back = ((1.0 - alpha)[..., None] * grads[0]).sum(dim=(0, 1))
        d_viewmat = None
        if pose is not None:
            d_viewmat = torch.zeros(4, 4, dtype=torch.float64)
            d_viewmat[:3, :3], d_viewmat[:3, 3] = pose[:9].reshape(3, 3), pose[9:]
            d_viewmat = d_viewmat.to(ctx.pose_dtype)
        return (*gradients, back, d_viewmat, None, None, None)


class _Harmonics(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        means, sh, camera, degree = inputs
        rgb = torch.empty(len(means), 3)
        arrays = [part.detach().numpy() for part in (means, sh, camera)]
        kernels.harmonics(*arrays, degree, rgb.numpy(), thread_count(), instruction_set())
        ctx.save_for_backward(means, sh, camera)
        ctx.degree = degree
        return rgb

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *grads: Any) -> tuple[Tensor | None, ...]:
        means, sh, camera = ctx.saved_tensors
        d_means, d_sh = torch.empty_like(means), torch.empty_like(sh)
        arrays = [part.detach().numpy() for part in (means, sh, camera)]
        outputs = [part.numpy() for part in (grads[0].contiguous(), d_means, d_sh)]
        kernels.harmonics_backward(*arrays, ctx.degree, *outputs, thread_count(), instruction_set())
        return d_means, d_sh, None, None
