"""gsplat 1.5.3 behind the same interface, for NVIDIA GPUs.

What gsplat fixes at compile time and this adapter cannot change: alpha_min 1/255 and transmittance_min 1e-4 (other
values are refused), an alpha clamp of 0.999 (`alpha_max` is not applied: nearly opaque Gaussians differ from the other
backends by up to 0.9 %), a radius of at most 3.33 standard deviations, and float32 covariances, which lose needles. It
does not report a median depth; that image is NaN here. `viewmat` is differentiable.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from service.common.camera import Camera
from service.common.errors import InvalidInputError, ModelUnavailableError
from service.splatting.raster import classify
from service.splatting.raster.reference import pair_bound_error
from service.splatting.raster.types import LabelMap, LabelSums, RasterSettings, Rendering, Splats

_ALPHA_MIN = 1.0 / 255.0
_TRANSMITTANCE_MIN = 1e-4


def rasterize(
    splats: Splats, viewmat: Tensor, camera: Camera, background: Tensor | None, settings: RasterSettings
) -> Rendering:
    """See `service.splatting.raster.rasterize`; the tensors must be on one CUDA device."""
    kernels = _gsplat(splats, settings)
    parts, rows, broken = _usable(splats)
    count, channels = splats.means.shape[0], splats.features.shape[1]
    back = torch.zeros(channels, device=splats.means.device) if background is None else background.float()
    pictures, alphas, meta = kernels.rasterization(
        *parts[:4],
        parts[4],
        viewmat.to(splats.means.device, torch.float32)[None],
        _intrinsics(camera, splats.means.device)[None],
        camera.width,
        camera.height,
        near_plane=settings.near,
        far_plane=settings.far,
        eps2d=settings.eps2d,
        packed=False,
        render_mode="RGB+D",
        rasterize_mode="classic",
    )
    if int(meta["flatten_ids"].numel()) > settings.max_pairs:
        raise pair_bound_error(settings.max_pairs)
    alpha = alphas[0, ..., 0]
    radii = torch.zeros(count, dtype=torch.int32, device=splats.means.device)
    found = meta["radii"][0].detach()
    radii[rows] = (found.amax(dim=-1) if found.ndim == 2 else found).to(torch.int32)
    return Rendering(
        image=pictures[0, ..., :channels] + (1.0 - alpha)[..., None] * back,
        alpha=alpha,
        depth=pictures[0, ..., channels],
        median_depth=torch.full_like(alpha.detach(), float("nan")),
        radii=radii,
        culled_non_finite=broken,
    )


def blend_sums(splats: Splats, viewmat: Tensor, camera: Camera, values: Tensor, settings: RasterSettings) -> Tensor:
    """See `service.splatting.raster.blend_sums`: the gradient of Σ image·value with respect to the features."""
    features = torch.zeros(len(splats.means), values.shape[2], device=splats.means.device, requires_grad=True)
    plain = Splats(
        splats.means.detach(), splats.quats.detach(), splats.scales.detach(), splats.opacities.detach(), features
    )
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


def _gsplat(splats: Splats, settings: RasterSettings) -> Any:
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
    if not splats.means.is_cuda:
        raise InvalidInputError("backend 'cuda' got tensors that are not on a GPU", field="backend")
    if abs(settings.alpha_min - _ALPHA_MIN) > 1e-9 or settings.transmittance_min != _TRANSMITTANCE_MIN:
        raise InvalidInputError(
            f"alpha_min {settings.alpha_min}, transmittance_min {settings.transmittance_min}: gsplat fixes both",
            field="settings",
            limit="alpha_min 1/255 and transmittance_min 1e-4 (backend cuda)",
        )
    return gsplat


def _usable(splats: Splats) -> tuple[list[Tensor], Tensor, int]:
    parts = [splats.means, splats.quats, splats.scales, splats.opacities, splats.features]
    good = torch.stack([torch.isfinite(part.detach()).reshape(len(part), -1).all(dim=1) for part in parts]).all(dim=0)
    rows = torch.nonzero(good & (splats.quats.detach().abs().amax(dim=1) > 0))[:, 0]
    return [part[rows].float() for part in parts], rows, int((~good).sum())


def _intrinsics(camera: Camera, device: torch.device) -> Tensor:
    rows = ((camera.fx, 0.0, camera.cx), (0.0, camera.fy, camera.cy), (0.0, 0.0, 1.0))
    return torch.tensor(rows, dtype=torch.float32, device=device)
