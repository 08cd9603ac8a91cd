"""Places in a scene and their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.common.combined_ratios import NORMAL_95
from fastsplat.service.query.objects.picking import check_pixel
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.gaussians.connectivity import rotations_of
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.rendering import accumulate_weights
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.object_prompts import Pixel
from fastsplat_contract.geometry.places import Place

F64 = NDArray[np.float64]

_LEAST_WEIGHT = 1e-4
_FLATTEST = 1e-3
_AROUND = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
_PICK_PX = 1.0
"""Standard deviation of a click, pixels of the picture clicked in."""


@dataclass(frozen=True)
class Located:
    """A place in world coordinates."""

    point: F64  # float64 [3]
    covariance: F64  # float64 [3, 3], scene units squared
    object_id: int = 0  # of the object there; 0 for none
    is_object: bool = False  # whether the place is that whole object, and `point` the middle of its box

    @property
    def plus_minus(self) -> float:
        """1.96 standard deviations in the least certain direction."""
        return float(NORMAL_95 * np.sqrt(np.linalg.eigvalsh(self.covariance)[-1].clip(0)))


def locate(index: SceneIndex, place: Place) -> Located:
    """Locates a pixel or a point; points are exact.

    Raises:
        NotFoundError: nothing is seen at the pixel, or no such view.
        InvalidInputError: see `check_place`; another frame; a pixel outside the picture; a point that is not finite.
    """
    check_place(place, ("pixel", "point"))
    if place.point is not None:
        point = np.array(place.point, dtype=np.float64)
        if not np.isfinite(point).all():
            raise InvalidInputError(f"a point at {tuple(place.point)}", field="point", hint="Send finite numbers.")
        near = index.objects.rows_at(place.point)
        return Located(point, np.zeros((3, 3)), int(index.objects.owner[near[0]]) if len(near) else 0)
    assert place.pixel is not None
    return _at_pixel(index, index.viewpoint(place.camera, place.view), place.pixel)


def check_place(place: Place, kinds: tuple[str, ...]) -> None:
    """Raises InvalidInputError unless a place has one of `kinds`, and a pixel one viewpoint."""
    said = [name for name in ("pixel", "point", "object_id") if getattr(place, name) is not None]
    if len(said) != 1 or said[0] not in kinds:
        raise InvalidInputError(
            f"a place by {' and '.join(said) or 'nothing'}",
            field=(said or [kinds[0]])[-1],
            hint=f"Send one of {', '.join(kinds)}.",
        )
    cameras = (place.camera is not None) + (place.view is not None)
    if cameras != (said == ["pixel"]):
        raise InvalidInputError(
            f"a {said[0]} with {cameras} viewpoints",
            field="view",
            hint="A pixel needs one of camera and view; a point and an object need none.",
        )


def _at_pixel(index: SceneIndex, posed: PosedCamera, pixel: Pixel) -> Located:
    """Locates the surface on the ray through a pixel.

    Each Gaussian in the pixel (blend weight w) is met where the ray is likeliest in it, at depth t = dᵀ Σ⁻¹ (μ - o) /
    dᵀ Σ⁻¹ d; the surface is their weighted median. Across the ray σ is the width of one pixel there; along the ray it
    is √(q² + s² + g²): q half of the weights' 16 % to 84 % range, s the mean deviation 1 / √(dᵀ Σ⁻¹ d) of the
    Gaussians, g the depth change per pixel, horizontally and vertically."""
    check_pixel(posed, pixel)
    camera = posed.camera
    rows, weights = _weights_around(index, posed, pixel)
    nothing = NotFoundError(
        f"there is nothing at the pixel ({pixel.x:g}, {pixel.y:g})",
        field="pixel",
        hint="Pick where the scene's pictures show something.",
    )
    if weights[:, 0].sum() < max(index.settings.alpha_min, _LEAST_WEIGHT):
        raise nothing
    origin, rotation = posed.world_from_camera[:3, 3], posed.world_from_camera[:3, :3]
    rays = [rotation @ camera.rays(pixel.x + x, pixel.y + y) for x, y in _AROUND]
    met = [_surface_depth(*_depths_along(index, rows, origin, ray), weights[:, n]) for n, ray in enumerate(rays)]
    if met[0] is None:
        raise nothing
    depth, spread = met[0]
    beside = [depth if surface is None else surface[0] for surface in met]
    slopes = (beside[1] - beside[2]) / 2, (beside[3] - beside[4]) / 2
    length = float(np.linalg.norm(rays[0]))
    ray = rays[0] / length
    along = length * float(np.sqrt(spread**2 + _PICK_PX**2 * (slopes[0] ** 2 + slopes[1] ** 2)))
    across = _PICK_PX * depth / float(np.sqrt(camera.fx * camera.fy))
    covariance = along**2 * np.outer(ray, ray) + across**2 * (np.eye(3) - np.outer(ray, ray))
    owners = np.bincount(index.objects.owner[rows], weights=weights[:, 0])
    return Located(origin + depth * rays[0], covariance, int(owners.argmax()))


def _surface_depth(depths: F64, thicknesses: F64, weights: F64) -> tuple[float, float] | None:
    """Weighted median of positive depths and its deviation; None without weight."""
    before = (depths > 0) & (weights > 0)
    if not before.any():
        return None
    depths, thicknesses, weights = depths[before], thicknesses[before], weights[before]
    order = np.argsort(depths, kind="stable")
    shares = np.cumsum(weights[order]) / weights.sum()
    low, median, high = depths[order][np.minimum(np.searchsorted(shares, (0.16, 0.5, 0.84)), len(order) - 1)]
    return float(median), float(np.hypot((high - low) / 2, weights @ thicknesses / weights.sum()))


def _weights_around(index: SceneIndex, posed: PosedCamera, pixel: Pixel) -> tuple[NDArray[np.int64], F64]:
    """Gaussians [K] in a pixel and four neighbors, and blend weights [K, 5]."""
    camera = posed.camera
    small = Camera(3, 3, camera.fx, camera.fy, camera.cx - pixel.x + 1.5, camera.cy - pixel.y + 1.5)
    backend = index.settings.backend
    device = device_of(backend)
    viewmat = torch.tensor(posed.camera_from_world(), dtype=torch.float32, device=device)
    values = torch.zeros(3, 3, len(_AROUND), device=device)
    for number, (x, y) in enumerate(_AROUND):
        values[1 + y, 1 + x, number] = 1.0
    with torch.no_grad():
        splats = splats_of(index.scene.gaussians, device=device)
        sums = accumulate_weights(splats, viewmat, small, values, backend=backend)
    weights = sums.cpu().numpy().astype(np.float64)
    rows = np.flatnonzero((weights > _LEAST_WEIGHT).any(axis=1))
    return rows, weights[rows]


def _depths_along(index: SceneIndex, rows: NDArray[np.int64], origin: F64, direction: F64) -> tuple[F64, F64]:
    """Likeliest depth of a ray in each Gaussian, and its deviation, both in `direction`s."""
    axes, deviations = axes_of(index, rows)
    inverse = 1 / np.maximum(deviations, _FLATTEST * deviations.max(axis=1, keepdims=True))
    away = np.einsum("kji,kj->ki", axes, index.scene.gaussians.means[rows].astype(np.float64) - origin) * inverse
    ray = np.einsum("kji,j->ki", axes, direction) * inverse
    precision = (ray * ray).sum(axis=1)
    return (away * ray).sum(axis=1) / precision, 1 / np.sqrt(precision)


def axes_of(index: SceneIndex, rows: NDArray[np.int64]) -> tuple[F64, F64]:
    """Principal axes (columns of [K, 3, 3]) and standard deviations [K, 3] of Gaussians `rows`."""
    gaussians = index.scene.gaussians
    return rotations_of(gaussians.quats[rows]), np.exp(gaussians.log_scales[rows].astype(np.float64))
