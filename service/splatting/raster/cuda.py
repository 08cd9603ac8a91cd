"""gsplat 1.5.3 backend for NVIDIA GPUs.

gsplat fixes alpha_min 1/255 and transmittance_min 1e-4 (other values are rejected), an alpha clamp of 0.999, a radius
of at most 3.33 standard deviations, and float32 covariances, which lose needles. The median depth is computed here, if
gradients are off.
"""

from __future__ import annotations

import logging
from functools import cache, lru_cache
from typing import Any

import torch
from torch import Tensor
from torch.nn.utils import get_total_norm

from fastsplat.service.splatting.raster import classify
from fastsplat.service.splatting.raster.checks import finite_rows, isect_limit_error
from fastsplat.service.splatting.raster.image_formation import LabelMap, LabelSums, RasterSettings, Rendering, Splats
from fastsplat.service.splatting.raster.median_depth import median_depth
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError
from fastsplat_contract.geometry.camera import Camera

logger = logging.getLogger(__name__)

DEVICE = "cuda"
_PARTS = ("means", "quats", "scales", "opacities", "features")
_ALPHA_MIN = 1.0 / 255.0
_ALPHA_MAX = 0.999
_TRANSMITTANCE_MIN = 1e-4


def rasterize(
    splats: Splats, viewmat: Tensor, camera: Camera, background: Tensor | None, settings: RasterSettings
) -> Rendering:
    """Implements `rendering.rasterize` on one CUDA device."""
    return _rasterize(splats, viewmat, camera, background, settings, median=not torch.is_grad_enabled())


def _rasterize(
    splats: Splats,
    viewmat: Tensor,
    camera: Camera,
    background: Tensor | None,
    settings: RasterSettings,
    *,
    median: bool,
) -> Rendering:
    gsplat = gsplat_module()
    _check(splats, settings)
    rows, non_finite = _usable(splats)
    device, channels = splats.means.device, splats.features.shape[1]
    drawn = splats if rows is None else Splats(*(getattr(splats, name)[rows] for name in _PARTS))
    if not len(drawn.means):
        return _empty(splats, camera, background, non_finite, median=median)
    pictures, alphas, meta = gsplat.rasterization(
        *(part.float() for part in (drawn.means, drawn.quats, drawn.scales, drawn.opacities)),
        drawn.features.float(),
        viewmat[None].to(device, torch.float32),
        _intrinsics(camera, device)[None],
        camera.width,
        camera.height,
        near_plane=settings.near,
        far_plane=settings.far,
        eps2d=settings.eps2d,
        packed=False,
        render_mode="RGB+D",
        rasterize_mode="classic",
    )
    if int(meta["flatten_ids"].numel()) > settings.max_isects:
        raise isect_limit_error(settings.max_isects)
    sizes = meta["radii"].detach()[0]
    radii = (sizes.amax(dim=-1) if sizes.ndim == 2 else sizes).to(torch.int32)
    if rows is not None:
        radii = torch.zeros(len(splats.means), dtype=torch.int32, device=device).index_copy_(0, rows, radii)
    alpha, image = alphas[0, ..., 0], pictures[0, ..., :channels]
    if background is not None:
        image = image + (1.0 - alpha)[..., None] * background.float()
    half = None
    if median:
        half = median_depth(meta, camera.height, camera.width, alpha_min=_ALPHA_MIN, alpha_max=_ALPHA_MAX)
    return Rendering(image, alpha, pictures[0, ..., channels], half, radii, non_finite)


def sh_to_rgb(means: Tensor, sh: Tensor, camera_position: Tensor, degree: int) -> Tensor:
    """Implements `rendering.sh_to_rgb` by gsplat's kernel: few launches instead of a hundred."""
    # Negligible offset that gives Gaussians at the camera, which are never drawn, a direction.
    directions = means - camera_position + 1e-12
    values: Tensor = gsplat_module().spherical_harmonics(degree, directions, sh[:, : (degree + 1) ** 2])
    return (values + 0.5).clamp_min(0.0)


def accumulate_weights(
    splats: Splats, viewmat: Tensor, camera: Camera, values: Tensor, settings: RasterSettings
) -> Tensor:
    """Computes the gradient of Σ image·value with respect to the features."""
    features = torch.zeros(len(splats.means), values.shape[2], device=splats.means.device, requires_grad=True)
    # Rows with non-finite features must be culled, although these features are not rendered.
    means = torch.where(finite_rows(splats)[:, None], splats.means.detach(), float("nan"))
    plain = Splats(means, splats.quats.detach(), splats.scales.detach(), splats.opacities.detach(), features)
    with torch.enable_grad():
        image = rasterize(plain, viewmat.detach(), camera, None, settings).image
        (sums,) = torch.autograd.grad((image * values).sum(), features)
    return sums.to(splats.means.dtype)


def label_map(
    splats: Splats, viewmat: Tensor, camera: Camera, head: classify.Head, settings: RasterSettings
) -> LabelMap:
    """Rasterizes, then classifies in chunks by torch."""
    drawn = _rasterize(splats, viewmat, camera, None, settings, median=False)
    return classify.label_map(drawn, head)


def label_sums(splats: Splats, viewmat: Tensor, camera: Camera, labels: Tensor, settings: RasterSettings) -> LabelSums:
    """Applies `accumulate_weights` to a few labels at a time."""
    labels = labels.to(splats.means.device)
    return classify.label_sums(
        labels, len(splats.means), lambda values: accumulate_weights(splats, viewmat, camera, values, settings)
    )


def gsplat_module() -> Any:
    """Imports gsplat.

    Raises:
        ModelUnavailableError: no GPU, gsplat is not installed, or its kernels could not be built.
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
    if not _has_kernels():
        raise ModelUnavailableError(
            "backend 'cuda' needs gsplat's kernels, which are not built and could not be",
            field="backend",
            hint="Install the CUDA toolkit (nvcc) of torch's version and a C++ compiler; what goes wrong is said by: "
            "VERBOSE=1 python -c \"import gsplat.cuda._backend\". Or use backend='cpu'.",
        )
    return gsplat


@cache
def _has_kernels() -> bool:
    """Builds gsplat's kernels on first use, which takes minutes."""
    try:
        from gsplat.cuda._backend import _C
    except Exception:  # torch's extension build raises RuntimeError, CalledProcessError, OSError, ...
        logger.exception("gsplat's kernels could not be built")
        return False
    return _C is not None


def _check(splats: Splats, settings: RasterSettings) -> None:
    if splats.means.device.type != DEVICE:
        raise InvalidInputError("backend 'cuda' got tensors that are not on a GPU", field="backend")
    if abs(settings.alpha_min - _ALPHA_MIN) > 1e-9 or settings.transmittance_min != _TRANSMITTANCE_MIN:
        raise InvalidInputError(
            f"alpha_min {settings.alpha_min}, transmittance_min {settings.transmittance_min}: gsplat fixes both",
            field="settings",
            limit="alpha_min 1/255 and transmittance_min 1e-4 (backend cuda)",
        )


def _usable(splats: Splats) -> tuple[Tensor | None, int]:
    """Returns usable rows (None for all) and the number of non-finite ones."""
    # A single norm tests all rows first, since indexing rows costs more than rendering them.
    lengths = torch.linalg.vector_norm(splats.quats.detach(), ord=torch.inf, dim=1)
    if len(lengths):
        norm = get_total_norm([getattr(splats, name).detach() for name in _PARTS])
        if bool(lengths.amin() > 0 * norm):  # 0 times a non-finite norm is NaN, which fails the comparison
            return None, 0
    finite = finite_rows(splats)
    return torch.nonzero(finite & (lengths > 0))[:, 0], int((~finite).sum())


def _empty(splats: Splats, camera: Camera, background: Tensor | None, non_finite: int, *, median: bool) -> Rendering:
    """Renders zero Gaussians, for which gsplat's kernels do not start."""
    count, channels = splats.features.shape
    # Sums over no rows make gradients zero instead of missing.
    none = splats.means[:0].sum() + splats.features[:0].sum()
    zero = none.float().expand(camera.height, camera.width)
    image = zero[..., None].expand(-1, -1, channels)
    image = image if background is None else image + background.float()
    radii = torch.zeros(count, dtype=torch.int32, device=zero.device)
    return Rendering(image, zero, zero, zero.detach() if median else None, radii, non_finite)


@lru_cache(maxsize=1024)  # avoids a transfer to the GPU in each step
def _intrinsics(camera: Camera, device: torch.device) -> Tensor:
    rows = ((camera.fx, 0.0, camera.cx), (0.0, camera.fy, camera.cy), (0.0, 0.0, 1.0))
    return torch.tensor(rows, dtype=torch.float32, device=device)
