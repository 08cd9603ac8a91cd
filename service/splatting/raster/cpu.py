"""C++ backend: torch.autograd around kernels that access torch memory in place.

A view keeps the thread count and instruction set it was prepared with (`service.splatting.raster.kernels`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, ParamSpec, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.splatting.raster import classify, harmonics
from fastsplat.service.splatting.raster.checks import isect_limit_error
from fastsplat.service.splatting.raster.image_formation import LabelMap, LabelSums, RasterSettings, Rendering, Splats
from fastsplat.service.splatting.raster.kernels import arrays, kernels, running
from fastsplat_contract.errors import CancelledError, InvalidInputError
from fastsplat_contract.geometry.camera import Camera

P = ParamSpec("P")
T = TypeVar("T")

_BAND_VALUES = 16 << 20  # image values held at once for classification


def rasterize(
    splats: Splats, viewmat: Tensor, camera: Camera, background: Tensor | None, settings: RasterSettings
) -> Rendering:
    """Implements `rendering.rasterize` in float32 (doubles once per Gaussian)."""
    return rasterize_with_context(splats, viewmat, camera, background, settings)[0]


def rasterize_with_context(
    splats: Splats, viewmat: Tensor, camera: Camera, background: Tensor | None, settings: RasterSettings
) -> tuple[Rendering, kernels.RenderContext]:
    """Also returns the kernels' record: visible, isects, milliseconds per stage."""
    dtype = splats.means.dtype
    parts = [_float32(part) for part in vars(splats).values()]
    back = torch.zeros(parts[4].shape[1]) if background is None else _float32(background)
    record: dict[str, kernels.RenderContext] = {}
    image, alpha, depth, median, radii = _Rasterize.apply(*parts, back, viewmat, camera, settings, record)  # type: ignore[no-untyped-call]
    if dtype != torch.float32:
        image, alpha, depth, median = (part.to(dtype) for part in (image, alpha, depth, median))
    context = record["context"]
    return Rendering(image, alpha, depth, median, radii, context.non_finite), context


def rasterize_bands(
    splats: Splats, viewmat: Tensor, camera: Camera, max_values: int, settings: RasterSettings
) -> Iterator[tuple[slice, Rendering]]:
    """Implements `rendering.rasterize_bands` with at least one row of tiles per band."""
    dtype = splats.means.dtype
    parts = [_float32(part.detach()) for part in vars(splats).values()]
    context, radii = _prepare(parts, viewmat, camera, settings)
    channels, tile = parts[4].shape[1], kernels.TILE_HEIGHT
    rows = max(1, max_values // max(1, camera.width * channels * tile)) * tile
    for start in range(0, camera.height, rows):
        band = slice(start, min(start + rows, camera.height))
        outputs = _composite(context, torch.zeros(channels), band, camera.width, settings)
        image, alpha, depth, median = (part.to(dtype) for part in outputs)
        yield band, Rendering(image, alpha, depth, median, radii, context.non_finite)


def accumulate_weights(
    splats: Splats, viewmat: Tensor, camera: Camera, values: Tensor, settings: RasterSettings
) -> Tensor:
    parts = [_float32(part.detach()) for part in vars(splats).values()]
    context, _ = _prepare(parts, viewmat, camera, settings)
    sums = torch.zeros(len(parts[0]), values.shape[-1])
    if sums.numel():
        _call(context.accumulate_weights, settings)(values=_float32(values.detach()).numpy(), sums=sums.numpy())
    return sums.to(splats.means.dtype)


def label_map(
    splats: Splats, viewmat: Tensor, camera: Camera, head: classify.Head, settings: RasterSettings
) -> LabelMap:
    channels, size = splats.features.shape[1], head.weight.shape[1]
    if channels > kernels.MAX_GROUP:
        bands = rasterize_bands(splats, viewmat, camera, _BAND_VALUES, settings)
        return classify.joined([classify.label_map(band, head) for _, band in bands])
    parts = [_float32(part.detach()) for part in vars(splats).values()]
    context, _ = _prepare(parts, viewmat, camera, settings)
    shape = (camera.height, camera.width)
    classes, alpha = torch.empty(shape, dtype=torch.int32), torch.empty(shape)
    expected = None if head.relevancy is None else torch.empty(shape)
    image = torch.empty(*shape, channels - size)
    values = None if head.relevancy is None else _float32(head.relevancy)
    given = arrays(weight=_float32(head.weight), bias=_float32(head.bias), relevancy=values)
    drawn = arrays(classes=classes, alpha=alpha, expected=expected, image=image)
    _call(context.label_map, settings)(**given, **drawn, alpha_min=head.alpha_min)
    dtype = splats.means.dtype
    expected = None if expected is None else expected.to(dtype)
    return LabelMap(classes, alpha.to(dtype), expected, image.to(dtype), context.non_finite)


def share_map(
    splats: Splats,
    viewmat: Tensor,
    camera: Camera,
    starts: NDArray[np.int64],
    labels: NDArray[np.uint16],
    shares: NDArray[np.float32],
    alpha_min: float,
    settings: RasterSettings,
) -> LabelMap:
    parts = [_float32(part.detach()) for part in vars(splats).values()]
    context, _ = _prepare(parts, viewmat, camera, settings)
    shape = (camera.height, camera.width)
    classes, alpha = torch.empty(shape, dtype=torch.int32), torch.empty(shape)
    _call(context.share_map, settings)(
        starts=starts, labels=labels, shares=shares, alpha_min=alpha_min, classes=classes.numpy(), alpha=alpha.numpy()
    )
    alpha = alpha.to(splats.means.dtype)
    return LabelMap(classes, alpha, None, alpha.new_zeros(*shape, 0), context.non_finite)


def label_sums(splats: Splats, viewmat: Tensor, camera: Camera, labels: Tensor, settings: RasterSettings) -> LabelSums:
    parts = [_float32(part.detach()) for part in vars(splats).values()]
    if labels.device.type != "cpu":
        raise InvalidInputError(f"the cpu backend got labels on {labels.device}", field="labels")
    context, _ = _prepare(parts, viewmat, camera, settings)
    starts = torch.empty(len(parts[0]) + 1, dtype=torch.int64)
    count = _call(context.label_sums, settings)(
        labels=labels.clamp(min=-1).to(torch.int32).contiguous().numpy(),
        max_entries=settings.max_isects,
        starts=starts.numpy(),
    )
    names, sums = torch.empty(count, dtype=torch.int32), torch.empty(count, dtype=torch.float64)
    context.label_entries(starts=starts.numpy(), labels=names.numpy(), sums=sums.numpy())
    return LabelSums(starts, names, sums)


def sh_to_rgb(means: Tensor, sh: Tensor, camera_position: Tensor, degree: int) -> Tensor:
    """Implements `rendering.sh_to_rgb`, by torch for other dtypes or camera gradients."""
    if means.dtype != torch.float32 or sh.dtype != torch.float32 or camera_position.requires_grad:
        return harmonics.sh_to_rgb(means, sh, camera_position, degree)
    rgb: Tensor = _SphericalHarmonics.apply(_float32(means), _float32(sh), _float32(camera_position.detach()), degree)  # type: ignore[no-untyped-call]
    return rgb


def _named(parts: Sequence[Tensor], prefix: str = "") -> dict[str, Any]:
    names = ("means", "quats", "scales", "opacities", "features")
    return arrays(**{prefix + name: part for name, part in zip(names, parts, strict=True)})


def _float32(tensor: Tensor) -> Tensor:
    if tensor.device.type != "cpu":
        raise InvalidInputError(f"the cpu backend got a tensor on {tensor.device}", field="backend")
    return tensor.to(torch.float32).contiguous()


def _prepare(
    parts: list[Tensor], viewmat: Tensor, camera: Camera, settings: RasterSettings
) -> tuple[kernels.RenderContext, Tensor]:
    radii = torch.empty(len(parts[0]), dtype=torch.int32)
    context = _call(kernels.prepare, settings)(
        **_named(parts),
        **arrays(viewmat=viewmat.to(torch.float64).contiguous(), radii=radii),
        camera=kernels.Camera(**vars(camera)),
        settings=kernels.RasterSettings(**vars(settings)),
        **running(),
    )
    return context, radii


def _composite(
    context: kernels.RenderContext, background: Tensor, rows: slice, width: int, settings: RasterSettings
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Renders image, alpha, depth and median depth of these rows."""
    shape = (rows.stop - rows.start, width)
    image = torch.empty(*shape, len(background))
    alpha, depth, median = torch.empty(shape), torch.empty(shape), torch.empty(shape)
    drawn = arrays(background=background, image=image, alpha=alpha, depth=depth, median_depth=median)
    _call(context.forward, settings)(**drawn, first_row=rows.start)
    return image, alpha, depth, median


def _call(kernel: Callable[P, T], settings: RasterSettings) -> Callable[P, T]:
    """Wraps a kernel to raise errors of the contract."""

    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return kernel(*args, **kwargs)
        except kernels.TooManyIsectsError:
            raise isect_limit_error(settings.max_isects) from None
        except kernels.CallCancelledError:
            check_cancelled()  # raises the specific reason
            raise CancelledError("the rendering was cancelled") from None

    return call


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[Tensor, ...]:
        *tensors, viewmat, camera, settings, record = inputs
        context, radii = _prepare([tensor.detach() for tensor in tensors[:5]], viewmat, camera, settings)
        rows = slice(0, camera.height)
        image, alpha, depth, median = _composite(context, tensors[5].detach(), rows, camera.width, settings)
        ctx.set_materialize_grads(False)
        ctx.mark_non_differentiable(median, radii)
        ctx.save_for_backward(*tensors, alpha)
        ctx.context, ctx.settings, ctx.pose_dtype = context, settings, viewmat.dtype
        record["context"] = context
        return image, alpha, depth, median, radii

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *grads: Any) -> tuple[Tensor | None, ...]:
        *tensors, alpha = ctx.saved_tensors
        grad_image, grad_alpha, grad_depth = (None if g is None else g.contiguous() for g in grads[:3])
        gradients = [torch.empty_like(tensor.detach()) for tensor in tensors[:5]]
        pose = torch.empty(12, dtype=torch.float64) if ctx.needs_input_grad[6] else None
        context: kernels.RenderContext = ctx.context
        _call(context.backward, ctx.settings)(
            **_named(tensors[:5]),
            **_named(gradients, "d_"),
            **arrays(background=tensors[5], grad_image=grad_image, grad_alpha=grad_alpha, grad_depth=grad_depth),
            **arrays(d_pose=pose),
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


class _SphericalHarmonics(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        means, sh, camera_position, degree = inputs
        rgb = torch.empty(len(means), 3)
        ctx.save_for_backward(means, sh, camera_position)
        ctx.degree, ctx.options = degree, running()
        given = arrays(means=means, sh=sh, camera_position=camera_position, rgb=rgb)
        kernels.spherical_harmonics(**given, degree=degree, **ctx.options)
        return rgb

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *grads: Any) -> tuple[Tensor | None, ...]:
        means, sh, camera_position = ctx.saved_tensors
        d_means, d_sh = torch.empty_like(means), torch.empty_like(sh)
        given = arrays(means=means, sh=sh, camera_position=camera_position, grad=grads[0].contiguous())
        kernels.spherical_harmonics_backward(
            **given, **arrays(d_means=d_means, d_sh=d_sh), degree=ctx.degree, **ctx.options
        )
        return d_means, d_sh, None, None
