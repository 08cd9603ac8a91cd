"""The public operations: check once, then hand over to a backend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from fastsplat.service.splatting.raster import harmonics
from fastsplat.service.splatting.raster.checks import backend_module, check_call
from fastsplat.service.splatting.raster.types import Backend, RasterSettings, Rendering, Splats
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
    """Render one view; differentiable in means, quats, scales, opacities, features, background and viewmat.

    On `cpu`, a signal handler that raises (Ctrl-C) ends even a long call within a fraction of a second.

    Args:
        splats: G Gaussians with C channels; any C.
        viewmat: [4, 4], camera from world (OpenCV axes), rigid; its gradient is that of twelve free numbers.
        camera: intrinsics and image size.
        background: [C], composited behind; None is zero.
        settings: cut-offs, the same forward and backward.
        backend: `reference` computes in float64, `cpu` and `cuda` in float32.

    Raises:
        InvalidInputError: shapes, devices or settings that do not fit together, or a viewmat with NaN or Inf.
        ResourceError: more Gaussian-tile pairs than `settings.max_pairs`.
        ModelUnavailableError: `cuda` without gsplat or a GPU.
    """
    check_call(splats, viewmat, camera, settings)
    _check_background(splats, background)
    rendering: Rendering = backend_module(backend).rasterize(splats, viewmat, camera, background, settings)
    return rendering


def rasterize_batch(
    splats: Splats,
    viewmats: Tensor,
    cameras: Sequence[Camera],
    *,
    background: Tensor | None = None,
    settings: RasterSettings = _DEFAULTS,
    backend: Backend = "cpu",
) -> tuple[Rendering, ...]:
    """Render several views of the same Gaussians; each as `rasterize` would, gradients add up over the views.

    `cuda` hands cameras of one image size to the GPU together; `cpu` and `reference` render one after the other, with
    all threads in each, because views share too little to gain from more: what does not depend on the camera is below
    1 % of a view.

    Args:
        splats: features may also be [V, G, C], those of each view (colours of spherical harmonics depend on it).
        viewmats: [V, 4, 4], camera from world.
        cameras: V intrinsics and image sizes, which may differ.
        background: [C], composited behind every view; None is zero.
        settings: cut-offs; `max_pairs` bounds each view.
        backend: as for `rasterize`.

    Raises:
        InvalidInputError, ResourceError, ModelUnavailableError, CancelledError: as `rasterize`.
    """
    count = len(cameras)
    if viewmats.shape != (count, 4, 4):
        raise InvalidInputError(f"viewmats {tuple(viewmats.shape)} for {count} cameras", field="viewmats")
    features = splats.features
    if features.ndim == 3 and features.shape[0] != count:
        raise InvalidInputError(f"features {tuple(features.shape)} for {count} cameras", field="features")
    views = [splats] * count
    if features.ndim == 3:
        views = [replace(splats, features=own) for own in features.unbind()]
    for view, viewmat, camera in zip(views, viewmats, cameras, strict=True):
        _check_background(view, background)
        check_call(view, viewmat, camera, settings)
    if not count:
        return ()
    module = backend_module(backend)
    if backend == "cuda":
        together: tuple[Rendering, ...] = module.rasterize_batch(views, viewmats, cameras, background, settings)
        return together
    return tuple(
        module.rasterize(view, viewmat, camera, background, settings)
        for view, viewmat, camera in zip(views, viewmats.unbind(), cameras, strict=True)
    )


def blend_sums(
    splats: Splats,
    viewmat: Tensor,
    camera: Camera,
    values: Tensor,
    *,
    settings: RasterSettings = _DEFAULTS,
    backend: Backend = "cpu",
) -> Tensor:
    """Σ_p w_g(p)·value(p) for every Gaussian, w its blend weight: [G, V]. No gradient.

    Args:
        splats: as for `rasterize`; features are not read, except that a non-finite row is culled.
        viewmat: [4, 4], camera from world.
        camera: intrinsics and image size.
        values: [H, W, V], e.g. one-hot labels.
        settings: cut-offs.
        backend: as for `rasterize`.

    Raises:
        InvalidInputError, ResourceError, ModelUnavailableError: as `rasterize`.
    """
    check_call(splats, viewmat, camera, settings)
    if values.ndim != 3 or values.shape[:2] != (camera.height, camera.width):
        raise InvalidInputError(
            f"values of shape {tuple(values.shape)} for an image of {camera.height}×{camera.width}", field="values"
        )
    sums: Tensor = backend_module(backend).blend_sums(splats, viewmat, camera, values, settings)
    return sums


def sh_to_rgb(means: Tensor, sh: Tensor, camera_position: Tensor, degree: int, *, backend: Backend = "cpu") -> Tensor:
    """Colour of each Gaussian seen from `camera_position`: max(0, 0.5 + Σ_k Y_k(d) sh_k), [G, 3].

    Args:
        means: [G, 3], world frame.
        sh: [G, K, 3] with K >= (degree + 1)², coefficient 0 first, 3DGS signs; further coefficients are not read.
        camera_position: [3], world frame; d = normalize(means − camera_position).
        degree: 0..3.
        backend: as for `rasterize`. Differentiable in means and sh.

    Raises:
        InvalidInputError: degree outside 0..3 or shapes that do not fit.
    """
    if degree not in (0, 1, 2, 3) or sh.ndim != 3 or sh.shape[1] < (degree + 1) ** 2 or sh.shape[2] != 3:
        raise InvalidInputError(
            f"harmonics of shape {tuple(sh.shape)} for degree {degree}",
            field="sh",
            hint="Pass [G, K, 3] with K >= (degree + 1)² and degree 0..3.",
        )
    if means.shape != (sh.shape[0], 3) or camera_position.shape != (3,):
        raise InvalidInputError(
            f"means {tuple(means.shape)}, sh {tuple(sh.shape)}, camera_position {tuple(camera_position.shape)}",
            field="means",
        )
    if backend == "cpu" and means.dtype == sh.dtype == torch.float32 and not camera_position.requires_grad:
        from fastsplat.service.splatting.raster import cpu

        return cpu.sh_to_rgb(means, sh, camera_position, degree)
    backend_module(backend)
    return harmonics.sh_to_rgb(means, sh, camera_position, degree)


def _check_background(splats: Splats, background: Tensor | None) -> None:
    channels = splats.features.shape[-1]
    if background is not None and background.shape != (channels,):
        raise InvalidInputError(
            f"a background of shape {tuple(background.shape)} for {channels} channels", field="background"
        )
    if background is not None and not bool(torch.isfinite(background.detach()).all()):
        raise InvalidInputError("the background holds NaN or Inf", field="background")
