"""Labels in the picture: what each pixel shows, and how much of each label every Gaussian is seen through."""

from __future__ import annotations

import torch
from torch import Tensor

from fastsplat.service.splatting.raster.checks import backend_module, check_call
from fastsplat.service.splatting.raster.types import Backend, LabelMap, LabelSums, RasterSettings, Splats
from fastsplat_contract.camera import Camera
from fastsplat_contract.errors import InvalidInputError

_DEFAULTS = RasterSettings()


def label_map(
    splats: Splats,
    viewmat: Tensor,
    camera: Camera,
    weight: Tensor,
    bias: Tensor,
    *,
    alpha_min: float,
    relevancy: Tensor | None = None,
    settings: RasterSettings = _DEFAULTS,
    backend: Backend = "cpu",
) -> LabelMap:
    """The most probable class of every pixel: argmax_n (W·Σ w·code + b)_n, ties to the lower id. No gradient.

    The composited code is not divided by alpha: that is what the training loss sees. Logits are held within ±1e30, as
    in that loss. `cpu` never writes codes of up to 16 numbers (with the image's channels) to memory; `reference`
    computes in float64, the others in float32.

    Args:
        splats: the last D of the C feature channels are the codes; channels before them come back as `image`.
        viewmat: [4, 4], camera from world.
        camera: intrinsics and image size.
        weight: [N + 1, D], row 0 is the undetected class; 0 <= D <= C.
        bias: [N + 1].
        alpha_min: pixels that the scene covers less than this are class 0.
        relevancy: [N + 1], of each class to a query; asks for its expectation in every pixel.
        settings: cut-offs.
        backend: as for `rasterize`.

    Raises:
        InvalidInputError: shapes that do not fit, or NaN or Inf in weight, bias or relevancy.
        ResourceError, ModelUnavailableError, CancelledError: as `rasterize`.
    """
    check_call(splats, viewmat, camera, settings)
    given = {"weight": weight, "bias": bias} | ({} if relevancy is None else {"relevancy": relevancy})
    classes = weight.shape[0] if weight.ndim == 2 else 0
    fits = classes > 0 and weight.shape[1] <= splats.features.shape[1]
    if not fits or any(part.shape != (classes,) for name, part in given.items() if name != "weight"):
        shapes = ", ".join(f"{name} {tuple(part.shape)}" for name, part in given.items())
        raise InvalidInputError(
            f"{shapes} for {splats.features.shape[1]} feature channels",
            field="weight",
            hint="weight [N + 1, D] with D at most the channels, bias and relevancy [N + 1], N + 1 at least 1.",
        )
    for name, part in given.items():
        if not bool(torch.isfinite(part).all()):
            raise InvalidInputError(f"{name} holds NaN or Inf", field=name)
    with torch.no_grad():
        found: LabelMap = backend_module(backend).label_map(
            splats, viewmat, camera, weight, bias, alpha_min, relevancy, settings
        )
    return found


def label_sums(
    splats: Splats,
    viewmat: Tensor,
    camera: Camera,
    labels: Tensor,
    classes: int,
    *,
    settings: RasterSettings = _DEFAULTS,
    backend: Backend = "cpu",
) -> LabelSums:
    """Σ_p w_g(p)·1[labels(p) = n] for every Gaussian g and label n (FlashSplat's evidence; Shen et al. 2024).

    Sparse, because a Gaussian is seen through few labels: memory grows with what is there, not with `classes`; use
    `LabelSums.dense` for a matrix. The bits do not depend on the number of threads. No gradient.

    Args:
        splats: as for `rasterize`; features are not read, except that a non-finite row is culled.
        viewmat: [4, 4], camera from world.
        camera: intrinsics and image size.
        labels: integers [H, W], below `classes`; pixels with a negative one count for nothing.
        classes: bound on the labels.
        settings: cut-offs; `max_pairs` bounds the entries of all Gaussians in all tiles as well.
        backend: as for `rasterize`.

    Raises:
        InvalidInputError: shapes that do not fit, or a label that is not below `classes`.
        ResourceError, ModelUnavailableError, CancelledError: as `rasterize`.
    """
    check_call(splats, viewmat, camera, settings)
    if labels.shape != (camera.height, camera.width) or labels.is_floating_point() or labels.is_complex():
        raise InvalidInputError(
            f"labels {tuple(labels.shape)} {labels.dtype} for an image of {camera.height}×{camera.width}",
            field="labels",
            hint="Pass integers [H, W].",
        )
    if labels.numel() and int(labels.max()) >= classes:
        raise InvalidInputError(f"a label {int(labels.max())} of {classes} classes", field="labels")
    with torch.no_grad():
        sums: LabelSums = backend_module(backend).label_sums(splats, viewmat, camera, labels, settings)
    return sums
