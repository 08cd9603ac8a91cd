"""Public rendering operations: validate arguments, then call a backend.

They raise `InvalidInputError` for shapes, devices or settings that do not match and non-finite viewmats,
`ResourceError` for more Gaussian-tile intersections than `settings.max_isects`, `ModelUnavailableError` for `cuda`
without gsplat or a GPU, and `CancelledError`. `reference` computes in float64, `cpu` and `cuda` in float32.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from fastsplat.service.common.sh_degree import MAX_SH_DEGREE
from fastsplat.service.splatting.raster import classify
from fastsplat.service.splatting.raster.checks import backend_module, check_call
from fastsplat.service.splatting.raster.classify import Head
from fastsplat.service.splatting.raster.image_formation import (
    Backend,
    LabelMap,
    LabelSums,
    RasterSettings,
    Rendering,
    Splats,
)
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera

_DEFAULTS = RasterSettings()


def rasterize(
    splats: Splats,  # G Gaussians with any number C of channels
    viewmat: Tensor,  # [4, 4], camera-from-world (OpenCV axes), rigid; its gradient treats twelve entries as free
    camera: Camera,
    *,
    background: Tensor | None = None,  # [C]; None is zero
    settings: RasterSettings = _DEFAULTS,
    backend: Backend = "cpu",
) -> Rendering:
    """Renders one view; differentiable in all tensors.

    >>> splats = Splats(torch.tensor([[0, 0, 2.0]]), torch.eye(1, 4), torch.ones(1, 3), torch.ones(1), torch.ones(1, 3))
    >>> view = rasterize(splats, torch.eye(4), Camera(width=4, height=2, fx=4.0, fy=4.0, cx=2.0, cy=1.0))
    >>> view.image.shape, view.alpha[0]
    (torch.Size([2, 4, 3]), tensor([0.7477, 0.9435, 0.9435, 0.7477]))

    On `cpu`, a signal handler that raises (Ctrl-C) ends even a long call within a fraction of a second.
    """
    check_call(splats, viewmat, camera, settings)
    channels = splats.features.shape[-1]
    if background is not None and background.shape != (channels,):
        raise InvalidInputError(
            f"a background of shape {tuple(background.shape)} for {channels} channels", field="background"
        )
    if background is not None and not bool(torch.isfinite(background.detach()).all()):
        raise InvalidInputError("the background holds NaN or Inf", field="background")
    rendering: Rendering = backend_module(backend).rasterize(splats, viewmat, camera, background, settings)
    return rendering


def rasterize_bands(
    splats: Splats,
    viewmat: Tensor,
    camera: Camera,
    *,
    max_values: int,  # limit of a band's image values, rows · W · C; a band has at least 16 rows
    settings: RasterSettings = _DEFAULTS,
    backend: Backend = "cpu",
) -> Iterator[tuple[slice, Rendering]]:
    """Renders one view in row bands from top to bottom, without gradients.

    Yields each band with its slice of rows: the pixels of `rasterize` on zero background, without the whole image in
    memory, except on `cuda` and `reference`.

    >>> splats = Splats(torch.tensor([[0, 0, 2.0]]), torch.eye(1, 4), torch.ones(1, 3), torch.ones(1), torch.ones(1, 3))
    >>> camera = Camera(width=4, height=20, fx=4.0, fy=4.0, cx=2.0, cy=10.0)
    >>> [(rows, band.image.shape) for rows, band in rasterize_bands(splats, torch.eye(4), camera, max_values=1)]
    [(slice(0, 16, None), torch.Size([16, 4, 3])), (slice(16, 20, None), torch.Size([4, 4, 3]))]
    """
    check_call(splats, viewmat, camera, settings)
    with torch.no_grad():
        module = backend_module(backend)
        if backend == "cpu":
            yield from module.rasterize_bands(splats, viewmat, camera, max_values, settings)
        else:  # they render whole images only, which are split
            yield from classify.bands(module.rasterize(splats, viewmat, camera, None, settings), max_values)


def accumulate_weights(
    splats: Splats,  # features only cull non-finite rows
    viewmat: Tensor,
    camera: Camera,
    values: Tensor,  # [H, W, V], e.g. one-hot labels
    *,
    settings: RasterSettings = _DEFAULTS,
    backend: Backend = "cpu",
) -> Tensor:
    """Returns Σ_p w_g(p)·value(p) per Gaussian, w its blend weight: [G, V]. No gradient.

    >>> splats = Splats(torch.tensor([[0, 0, 2.0]]), torch.eye(1, 4), torch.ones(1, 3), torch.ones(1), torch.ones(1, 3))
    >>> camera = Camera(width=4, height=2, fx=4.0, fy=4.0, cx=2.0, cy=1.0)
    >>> accumulate_weights(splats, torch.eye(4), camera, torch.tensor([[[0.1, 0.2]]]).expand(2, 4, 2))
    tensor([[0.6765, 1.3530]])
    """
    check_call(splats, viewmat, camera, settings)
    if values.ndim != 3 or values.shape[:2] != (camera.height, camera.width):
        raise InvalidInputError(
            f"values of shape {tuple(values.shape)} for an image of {camera.height}×{camera.width}", field="values"
        )
    sums: Tensor = backend_module(backend).accumulate_weights(splats, viewmat, camera, values, settings)
    return sums


def label_map(
    splats: Splats,  # the last D of the C channels are the codes; those before are returned as `image`
    viewmat: Tensor,
    camera: Camera,
    weight: Tensor,  # [N + 1, D], row 0 is the undetected class; 0 <= D <= C
    bias: Tensor,  # [N + 1]
    *,
    alpha_min: float,  # pixels with less alpha are class 0
    relevancy: Tensor | None = None,  # [N + 1], value of each class; requests its expectation per pixel
    settings: RasterSettings = _DEFAULTS,
    backend: Backend = "cpu",
) -> LabelMap:
    """Classifies pixels: argmax_n (W·Σ w·code + b)_n, ties to the lower id. No gradient.

    As in the training loss, the composited code is not divided by alpha, and logits are clamped to ±1e30.

    >>> splats = Splats(torch.tensor([[0, 0, 2.0]]), torch.eye(1, 4), torch.ones(1, 3), torch.ones(1), torch.ones(1, 3))
    >>> camera = Camera(width=4, height=2, fx=4.0, fy=4.0, cx=2.0, cy=1.0)
    >>> weight, bias = torch.tensor([[0.0, 0, 0], [1, 0, 0]]), torch.zeros(2)
    >>> label_map(splats, torch.eye(4), camera, weight, bias, alpha_min=0.9).classes[0]
    tensor([0, 1, 1, 0], dtype=torch.int32)
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
        how = Head(weight, bias, relevancy, alpha_min)
        labels: LabelMap = backend_module(backend).label_map(splats, viewmat, camera, how, settings)
    return labels


def label_sums(
    splats: Splats,  # features only cull non-finite rows
    viewmat: Tensor,
    camera: Camera,
    labels: Tensor,  # integers [H, W], below `classes`; negative ones are ignored
    classes: int,
    *,
    settings: RasterSettings = _DEFAULTS,  # `max_isects` also bounds the entries of all Gaussians in all tiles
    backend: Backend = "cpu",
) -> LabelSums:
    """Returns Σ_p w_g(p)·1[labels(p) = n] per Gaussian g and label n. No gradient.

    FlashSplat's evidence (Shen et al. 2024), sparse. Bit-identical for any number of threads.

    >>> splats = Splats(torch.tensor([[0, 0, 2.0]]), torch.eye(1, 4), torch.ones(1, 3), torch.ones(1), torch.ones(1, 3))
    >>> camera = Camera(width=4, height=2, fx=4.0, fy=4.0, cx=2.0, cy=1.0)
    >>> label_sums(splats, torch.eye(4), camera, torch.tensor([[0, 1, 1, -1]] * 2), 2).dense(2)
    tensor([[1.4955, 3.7741]], dtype=torch.float64)
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
    """Computes view-dependent colors max(0, 0.5 + Σ_k Y_k(d) sh_k), [G, 3].

    Differentiable in means and sh; d = normalize(means − camera_position).

    Args:
        means: [G, 3], world frame.
        sh: [G, K, 3] with K >= (degree + 1)², 3DGS signs; further coefficients are ignored.
        camera_position: [3], world frame.

    >>> sh_to_rgb(torch.tensor([[0, 0, 2.0]]), torch.zeros(1, 4, 3), torch.zeros(3), degree=1)
    tensor([[0.5000, 0.5000, 0.5000]])
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
