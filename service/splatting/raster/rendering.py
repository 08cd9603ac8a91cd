"""The public operations: arguments are checked once, then a backend computes."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from fastsplat.service.common.sh_degree import MAX_SH_DEGREE
from fastsplat.service.splatting.raster.checks import backend_module, check_call
from fastsplat.service.splatting.raster.types import Backend, LabelMap, LabelSums, RasterSettings, Rendering, Splats
from fastsplat_contract.camera import Camera
from fastsplat_contract.errors import InvalidInputError

_DEFAULTS = RasterSettings()


def rasterize(
    splats: Splats,
    viewmat: Tensor,
    camera: Camera,
    *,
    background: Tensor | None = None,
    settings: RasterSettings = _DEFAULTS,
    backend: Backend = "cpu",
) -> Rendering:
    """Renders one view; differentiable in means, quats, scales, opacities, features, background and viewmat.

    On `cpu`, a signal handler that raises (Ctrl-C) ends even a long call within a fraction of a second.

    Args:
        splats: G Gaussians with C channels; any C.
        viewmat: [4, 4], camera from world (OpenCV axes), rigid; its gradient is that of twelve free numbers.
        background: [C], composited behind; None is zero.
        settings: cut-offs, the same forward and backward.
        backend: `reference` computes in float64, `cpu` and `cuda` in float32.

    Raises:
        InvalidInputError: shapes, devices or settings that do not fit together, or a viewmat with NaN or Inf.
        ResourceError: more Gaussian-tile intersections than `settings.max_isects`.
        ModelUnavailableError: `cuda` without gsplat or a GPU.
        CancelledError: see `service.common.cancellation`.
    """
    check_call(splats, viewmat, camera, settings)
    _check_background(splats, background)
    rendering: Rendering = backend_module(backend).rasterize(splats, viewmat, camera, background, settings)
    return rendering


def rasterize_bands(
    splats: Splats,
    viewmat: Tensor,
    camera: Camera,
    *,
    max_values: int,
    settings: RasterSettings = _DEFAULTS,
    backend: Backend = "cpu",
) -> Iterator[tuple[slice, Rendering]]:
    """Renders one view in bands of whole rows from top to bottom, each with its slice of rows: the same pixels and
    errors as `rasterize` on a zero background, without a gradient, and never the whole image in memory.

    Args:
        max_values: bound on the numbers of a band's image (rows · W · C), except that a band has at least 16 rows.
            `cuda` renders the whole image first and hands out parts of it.
    """
    check_call(splats, viewmat, camera, settings)
    with torch.no_grad():
        yield from backend_module(backend).rasterize_bands(splats, viewmat, camera, max_values, settings)


def accumulate_weights(
    splats: Splats,
    viewmat: Tensor,
    camera: Camera,
    values: Tensor,
    *,
    settings: RasterSettings = _DEFAULTS,
    backend: Backend = "cpu",
) -> Tensor:
    """Σ_p w_g(p)·value(p) for every Gaussian, w its blend weight: [G, V]. No gradient; arguments and errors as
    `rasterize`.

    Args:
        splats: features are not read, except that a non-finite row is culled.
        values: [H, W, V], e.g. one-hot labels.
    """
    check_call(splats, viewmat, camera, settings)
    if values.ndim != 3 or values.shape[:2] != (camera.height, camera.width):
        raise InvalidInputError(
            f"values of shape {tuple(values.shape)} for an image of {camera.height}×{camera.width}", field="values"
        )
    sums: Tensor = backend_module(backend).accumulate_weights(splats, viewmat, camera, values, settings)
    return sums


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
    """The most probable class of every pixel: argmax_n (W·Σ w·code + b)_n, ties to the lower id. No gradient; arguments
    and errors as `rasterize`. As in the training loss, the composited code is not divided by alpha, and logits are held
    within ±1e30.

    Args:
        splats: the last D of the C feature channels are the codes; channels before them come back as `image`.
        weight: [N + 1, D], row 0 is the undetected class; 0 <= D <= C.
        bias: [N + 1].
        alpha_min: pixels that the scene covers less than this are class 0.
        relevancy: [N + 1], of each class to a query; asks for its expectation in every pixel.

    Raises:
        InvalidInputError: shapes that do not fit, or NaN or Inf in weight, bias or relevancy.
    """
    check_call(splats, viewmat, camera, settings)
    head = {"weight": weight, "bias": bias} | ({} if relevancy is None else {"relevancy": relevancy})
    classes = weight.shape[0] if weight.ndim == 2 else 0
    fits = classes > 0 and weight.shape[1] <= splats.features.shape[1]
    if not fits or any(part.shape != (classes,) for name, part in head.items() if name != "weight"):
        shapes = ", ".join(f"{name} {tuple(part.shape)}" for name, part in head.items())
        raise InvalidInputError(
            f"{shapes} for {splats.features.shape[1]} feature channels",
            field="weight",
            hint="weight [N + 1, D] with D at most the channels, bias and relevancy [N + 1], N + 1 at least 1.",
        )
    for name, part in head.items():
        if not bool(torch.isfinite(part).all()):
            raise InvalidInputError(f"{name} holds NaN or Inf", field=name)
    with torch.no_grad():
        labels: LabelMap = backend_module(backend).label_map(
            splats, viewmat, camera, weight, bias, alpha_min, relevancy, settings
        )
    return labels


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

    Sparse: memory grows with what is there. The bits do not depend on the number of threads. No gradient; arguments and
    errors as `rasterize`.

    Args:
        splats: features are not read, except that a non-finite row is culled.
        labels: integers [H, W], below `classes`; pixels with a negative one count for nothing.
        settings: cut-offs; `max_isects` bounds the entries of all Gaussians in all tiles as well.

    Raises:
        InvalidInputError: shapes that do not fit, or a label that is not below `classes`.
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


def sh_to_rgb(means: Tensor, sh: Tensor, camera_position: Tensor, degree: int, *, backend: Backend = "cpu") -> Tensor:
    """Color of each Gaussian seen from `camera_position`: max(0, 0.5 + Σ_k Y_k(d) sh_k), [G, 3].

    Args:
        means: [G, 3], world frame.
        sh: [G, K, 3] with K >= (degree + 1)², coefficient 0 first, 3DGS signs; further coefficients are not read.
        camera_position: [3], world frame; d = normalize(means − camera_position).
        degree: 0..3; `InvalidInputError` beyond, or for shapes that do not fit.
        backend: as for `rasterize`. Differentiable in means and sh.
    """
    known = 0 <= degree <= MAX_SH_DEGREE
    if not known or sh.ndim != 3 or sh.shape[1] < (degree + 1) ** 2 or sh.shape[2] != 3:
        raise InvalidInputError(
            f"harmonics of shape {tuple(sh.shape)} for degree {degree}",
            field="sh",
            hint=f"Pass [G, K, 3] with K >= (degree + 1)² and degree 0..{MAX_SH_DEGREE}.",
        )
    if means.shape != (sh.shape[0], 3) or camera_position.shape != (3,):
        raise InvalidInputError(
            f"means {tuple(means.shape)}, sh {tuple(sh.shape)}, camera_position {tuple(camera_position.shape)}",
            field="means",
        )
    rgb: Tensor = backend_module(backend).sh_to_rgb(means, sh, camera_position, degree)
    return rgb


def _check_background(splats: Splats, background: Tensor | None) -> None:
    channels = splats.features.shape[-1]
    if background is not None and background.shape != (channels,):
        raise InvalidInputError(
            f"a background of shape {tuple(background.shape)} for {channels} channels", field="background"
        )
    if background is not None and not bool(torch.isfinite(background.detach()).all()):
        raise InvalidInputError("the background holds NaN or Inf", field="background")
