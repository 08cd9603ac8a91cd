"""gsplat 1.5.3 behind the same interface, for NVIDIA GPUs.

What gsplat fixes at compile time and this adapter cannot change: alpha_min 1/255 and transmittance_min 1e-4 (other
values are refused), an alpha clamp of 0.999 (`alpha_max` is not applied: nearly opaque Gaussians differ from the other
backends by up to 0.9 %), a radius of at most 3.33 standard deviations, and float32 covariances, which lose needles. It
does not report a median depth; that image is NaN here. `viewmat` is differentiable.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from fastsplat.service.splatting.raster import classify
from fastsplat.service.splatting.raster.reference import finite_rows, pair_bound_error
from fastsplat.service.splatting.raster.types import LabelMap, LabelSums, RasterSettings, Rendering, Splats
from fastsplat_contract.camera import Camera
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError

DEVICE = "cuda"
_ALPHA_MIN = 1.0 / 255.0
_TRANSMITTANCE_MIN = 1e-4


def rasterize(
    splats: Splats, viewmat: Tensor, camera: Camera, background: Tensor | None, settings: RasterSettings
) -> Rendering:
    """See `service.splatting.raster.rasterize`; the tensors must be on one CUDA device."""
    return rasterize_batch([splats], viewmat[None], [camera], background, settings)[0]


def rasterize_batch(
    views: Sequence[Splats],
    viewmats: Tensor,
    cameras: Sequence[Camera],
    background: Tensor | None,
    settings: RasterSettings,
) -> tuple[Rendering, ...]:
    """See `service.splatting.raster.rasterize_batch`; `views` differ in their features at most."""
    kernels = gsplat_module()
    for splats in views:
        _check(splats, settings)
    usable = [_usable(splats) for splats in views]
    same_size = len({(camera.width, camera.height) for camera in cameras}) == 1
    if len(views) > 1 and not (same_size and all(torch.equal(rows, usable[0][0]) for rows, _ in usable)):
        return tuple(
            rasterize_batch([splats], viewmat[None], [camera], background, settings)[0]
            for splats, viewmat, camera in zip(views, viewmats.unbind(), cameras, strict=True)
        )
    device, (rows, _), camera, first = views[0].means.device, usable[0], cameras[0], views[0]
    count, channels = first.features.shape
    if not len(rows):
        return tuple(_empty(splats, camera, background, found[1]) for splats, found in zip(views, usable, strict=True))
    own = any(splats.features is not first.features for splats in views)
    pictures, alphas, meta = kernels.rasterization(
        *(part[rows].float() for part in (first.means, first.quats, first.scales, first.opacities)),
        torch.stack([splats.features[rows].float() for splats in views]) if own else first.features[rows].float(),
        viewmats.to(device, torch.float32),
        torch.stack([_intrinsics(camera, device) for camera in cameras]),
        camera.width,
        camera.height,
        near_plane=settings.near,
        far_plane=settings.far,
        eps2d=settings.eps2d,
        packed=False,
        render_mode="RGB+D",
        rasterize_mode="classic",
    )
    if int(meta["flatten_ids"].numel()) > settings.max_pairs * len(views):
        raise pair_bound_error(settings.max_pairs)
    found = meta["radii"].detach()
    found = (found.amax(dim=-1) if found.ndim == 3 else found).to(torch.int32)
    radii = torch.zeros(len(views), count, dtype=torch.int32, device=device)
    radii[:, rows] = found
    alpha = alphas[..., 0]
    image = pictures[..., :channels]
    if background is not None:
        image = image + (1.0 - alpha)[..., None] * background.float()
    return tuple(
        Rendering(
            image=image[index],
            alpha=alpha[index],
            depth=pictures[index, ..., channels],
            median_depth=torch.full_like(alpha[index].detach(), float("nan")),
            radii=radii[index],
            culled_non_finite=usable[index][1],
        )
        for index in range(len(views))
    )


def blend_sums(splats: Splats, viewmat: Tensor, camera: Camera, values: Tensor, settings: RasterSettings) -> Tensor:
    """See `service.splatting.raster.blend_sums`: the gradient of Σ image·value with respect to the features."""
    features = torch.zeros(len(splats.means), values.shape[2], device=splats.means.device, requires_grad=True)
    # A row that is not finite must not be drawn, though the features that say so are not.
    means = torch.where(finite_rows(splats)[:, None], splats.means.detach(), float("nan"))
    plain = Splats(means, splats.quats.detach(), splats.scales.detach(), splats.opacities.detach(), features)
    with torch.enable_grad():
        image = rasterize(plain, viewmat.detach(), camera, None, settings).image
        (sums,) = torch.autograd.grad((image * values).sum(), features)
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
    """See `service.splatting.raster.label_map`: rasterized, then classified by torch in pieces."""
    return classify.label_map(rasterize(splats, viewmat, camera, None, settings), weight, bias, alpha_min, relevancy)


def label_sums(splats: Splats, viewmat: Tensor, camera: Camera, labels: Tensor, settings: RasterSettings) -> LabelSums:
    """See `service.splatting.raster.label_sums`: `blend_sums` of a few labels at a time."""
    labels = labels.to(splats.means.device)
    return classify.label_sums(
        labels, len(splats.means), lambda values: blend_sums(splats, viewmat, camera, values, settings)
    )


def gsplat_module() -> Any:
    """gsplat.

    Raises:
        ModelUnavailableError: no GPU, or gsplat is not installed.
    """
    if not torch.cuda.is_available():
        raise ModelUnavailableError(
            "backend 'cuda' needs an NVIDIA GPU, and torch sees none", field="backend", hint="Use backend='cpu'."
        )
    try:
        import gsplat
    except ImportError as error:
        raise ModelUnavailableError(
            "backend 'cuda' needs gsplat", field="backend", hint="Install it: pip install 'fastsplat[cuda]'."
        ) from error
    return gsplat


def _check(splats: Splats, settings: RasterSettings) -> None:
    if splats.means.device.type != DEVICE:
        raise InvalidInputError("backend 'cuda' got tensors that are not on a GPU", field="backend")
    if abs(settings.alpha_min - _ALPHA_MIN) > 1e-9 or settings.transmittance_min != _TRANSMITTANCE_MIN:
        raise InvalidInputError(
            f"alpha_min {settings.alpha_min}, transmittance_min {settings.transmittance_min}: gsplat fixes both",
            field="settings",
            limit="alpha_min 1/255 and transmittance_min 1e-4 (backend cuda)",
        )


def _usable(splats: Splats) -> tuple[Tensor, int]:
    """Rows that gsplat may see, and how many of the others are not finite."""
    good = finite_rows(splats)
    rows = torch.nonzero(good & (splats.quats.detach().abs().amax(dim=1) > 0))[:, 0]
    return rows, int((~good).sum())


def _empty(splats: Splats, camera: Camera, background: Tensor | None, broken: int) -> Rendering:
    """A view of nothing: gsplat's kernels do not start for 0 Gaussians."""
    count, channels = splats.features.shape
    # Sums over no rows, so that gradients are zeros and not missing.
    none = splats.means[:0].sum() + splats.features[:0].sum()
    zero = none.float().expand(camera.height, camera.width)
    image = zero[..., None].expand(-1, -1, channels)
    return Rendering(
        image=image if background is None else image + background.float(),
        alpha=zero,
        depth=zero,
        median_depth=torch.zeros_like(zero.detach()),
        radii=torch.zeros(count, dtype=torch.int32, device=zero.device),
        culled_non_finite=broken,
    )


def _intrinsics(camera: Camera, device: torch.device) -> Tensor:
    rows = ((camera.fx, 0.0, camera.cx), (0.0, camera.fy, camera.cy), (0.0, 0.0, 1.0))
    return torch.tensor(rows, dtype=torch.float32, device=device)
