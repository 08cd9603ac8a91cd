"""Argument checks and errors shared by the backends, and backend selection."""

from __future__ import annotations

import importlib
import math
from typing import Any

import torch
from torch import Tensor

from fastsplat.service.splatting.raster.image_formation import Backend, RasterSettings, Splats
from fastsplat_contract.errors import InvalidInputError, ResourceError
from fastsplat_contract.geometry.camera import Camera

_MAX_SIDE = 16384


def backend_module(backend: str) -> Any:
    """Imports a backend's module lazily, so that a missing one affects only its users.

    Raises:
        InvalidInputError: unknown backend.
        ModelUnavailableError: `cpu` without the compiled extension.
    """
    if backend not in ("reference", "cpu", "cuda"):
        raise InvalidInputError(f"no rasterizer backend {backend!r}", field="backend", hint="reference, cpu or cuda")
    return importlib.import_module(f"fastsplat.service.splatting.raster.{backend}")


def device_of(backend: Backend) -> torch.device:
    """Returns the device of a backend's tensors.

    Raises:
        InvalidInputError: unknown backend.
        ModelUnavailableError: `cuda` without a GPU or gsplat, `cpu` without the compiled extension.
    """
    module = backend_module(backend)
    if backend != "cuda":
        return torch.device("cpu")
    module.gsplat_module()
    return torch.device(module.DEVICE)


def finite_rows(splats: Splats) -> Tensor:
    """Marks Gaussians whose inputs are all finite, bool [G]."""
    parts = (splats.means, splats.quats, splats.scales, splats.opacities[:, None], splats.features)
    return torch.stack([torch.isfinite(part.detach()).all(dim=1) for part in parts]).all(dim=0)


def isect_limit_error(max_isects: int) -> ResourceError:
    """Error for a view with more Gaussian-tile intersections than the settings allow."""
    return ResourceError(
        f"this view needs more than {max_isects} Gaussian-tile intersections (max_isects)",
        field="max_isects",
        limit=f"{max_isects} intersections (max_isects)",
        hint="Render a smaller image, remove oversized Gaussians, or raise max_isects (about 100 bytes each).",
    )


def check_call(splats: Splats, viewmat: Tensor, camera: Camera, settings: RasterSettings) -> None:
    """Raises InvalidInputError for invalid shapes, cut-offs or viewmats, and too large images."""
    count = splats.means.shape[0] if splats.means.ndim else -1
    shapes = {"means": (count, 3), "quats": (count, 4), "scales": (count, 3), "opacities": (count,)}
    for name, shape in shapes.items():
        tensor: Tensor = getattr(splats, name)
        if tensor.shape != shape:
            raise InvalidInputError(f"{name} of shape {tuple(tensor.shape)}, expected {shape}", field=name)
    if splats.features.ndim != 2 or splats.features.shape[0] != count:
        raise InvalidInputError(
            f"features of shape {tuple(splats.features.shape)} for {count} Gaussians", field="features"
        )
    if viewmat.shape != (4, 4) or not math.isfinite(float(viewmat.detach().sum())):
        raise InvalidInputError("the viewmat is not a finite [4, 4] matrix", field="viewmat")
    if max(camera.width, camera.height) > _MAX_SIDE:
        raise InvalidInputError(
            f"an image of {camera.width}×{camera.height} pixels", field="camera", limit=f"{_MAX_SIDE} pixels a side"
        )
    possible = (
        0.0 < settings.alpha_min < settings.alpha_max < 1.0
        and 0.0 < settings.transmittance_min < 1.0
        and 0.0 < settings.near < settings.far
        and settings.eps2d > 0.0
    )
    if not possible:
        raise InvalidInputError(
            f"cut-offs that cannot work: {settings}",
            field="settings",
            hint="0 < alpha_min < alpha_max < 1, 0 < transmittance_min < 1, 0 < near < far, eps2d > 0.",
        )
