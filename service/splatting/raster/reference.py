"""Test oracle: float64 torch with autograd on a dense Gaussian × pixel matrix.

Sources: EWA splatting (Zwicker et al. 2001), 3DGS (Kerbl et al. 2023, section 4), gsplat's supplement (Ye & Kanazawa
2023).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from fastsplat.service.splatting.raster import classify
from fastsplat.service.splatting.raster.checks import finite_rows, isect_limit_error
from fastsplat.service.splatting.raster.harmonics import sh_to_rgb as sh_to_rgb
from fastsplat.service.splatting.raster.image_formation import LabelMap, LabelSums, RasterSettings, Rendering, Splats
from fastsplat_contract.geometry.camera import Camera

_CHUNK = 4_000_000
_TILE = 16
_MAX_RADIUS = 2.0**30


@dataclass(frozen=True)
class _Projected:
    """V visible Gaussians, nearest first."""

    ids: Tensor  # rows of the input
    centers: Tensor
    whiten: Tensor  # Lᵀ of the 2D covariance's inverse
    depths: Tensor
    opacities: Tensor
    features: Tensor


def rasterize(
    splats: Splats, viewmat: Tensor, camera: Camera, background: Tensor | None, settings: RasterSettings
) -> Rendering:
    """Implements `rendering.rasterize` in float64 for any input dtype."""
    dtype = splats.means.dtype
    finite = finite_rows(splats)
    projected, radii = _project(splats, viewmat, camera, settings, finite)
    channels = splats.features.shape[1]
    back = torch.zeros(channels, dtype=torch.float64) if background is None else background.double()
    images, alphas, depths, medians = [], [], [], []
    for pixels in _pixel_chunks(camera, len(projected.ids)):
        weights, transmittance, before = _weights(projected, pixels, settings)
        final = transmittance[:, -1]
        images.append(weights @ projected.features + final[:, None] * back)
        alphas.append(1.0 - final)
        depths.append(weights @ projected.depths)
        crosses = ((before > 0.5) & (transmittance[:, 1:] <= 0.5)).double()
        medians.append((crosses @ projected.depths).detach())
    shape = (camera.height, camera.width)
    return Rendering(
        image=torch.cat(images).reshape(*shape, channels).to(dtype),
        alpha=torch.cat(alphas).reshape(shape).to(dtype),
        depth=torch.cat(depths).reshape(shape).to(dtype),
        median_depth=torch.cat(medians).reshape(shape).to(dtype),
        radii=radii,
        culled_non_finite=int((~finite).sum()),
    )


def accumulate_weights(
    splats: Splats, viewmat: Tensor, camera: Camera, values: Tensor, settings: RasterSettings
) -> Tensor:
    with torch.no_grad():
        projected, _ = _project(splats, viewmat, camera, settings, finite_rows(splats))
        flat = values.reshape(-1, values.shape[-1]).double()
        sums = torch.zeros(len(projected.ids), values.shape[-1], dtype=torch.float64)
        start = 0
        for pixels in _pixel_chunks(camera, len(projected.ids)):
            weights, _, _ = _weights(projected, pixels, settings)
            sums += weights.T @ flat[start : start + len(pixels)]
            start += len(pixels)
        result = torch.zeros(len(splats.means), values.shape[-1], dtype=torch.float64)
        result[projected.ids] = sums
        return result.to(splats.means.dtype)


def label_map(
    splats: Splats, viewmat: Tensor, camera: Camera, head: classify.Head, settings: RasterSettings
) -> LabelMap:
    exact = Splats(**{name: part.double() for name, part in vars(splats).items()})
    rendering = rasterize(exact, viewmat, camera, None, settings)
    labels = classify.label_map(rendering, head)
    dtype = splats.means.dtype
    expected = None if labels.relevancy is None else labels.relevancy.to(dtype)
    return replace(labels, alpha=labels.alpha.to(dtype), relevancy=expected, image=labels.image.to(dtype))


def label_sums(splats: Splats, viewmat: Tensor, camera: Camera, labels: Tensor, settings: RasterSettings) -> LabelSums:
    exact = Splats(**{name: part.double() for name, part in vars(splats).items()})
    return classify.label_sums(
        labels, len(splats.means), lambda values: accumulate_weights(exact, viewmat, camera, values, settings)
    )


def _project(
    splats: Splats, viewmat: Tensor, camera: Camera, settings: RasterSettings, finite: Tensor
) -> tuple[_Projected, Tensor]:
    """Culls, projects and sorts by depth; culled rows take no part in arithmetic."""
    with torch.no_grad():
        usable = finite & (splats.quats.abs().amax(dim=1) > 0) & (splats.opacities >= settings.alpha_min)
        z = splats.means.double() @ viewmat[2, :3].double() + viewmat[2, 3].double()
        ids = torch.nonzero(usable & (z > settings.near) & (z < settings.far))[:, 0]
    rotation, translation = viewmat[:3, :3].double(), viewmat[:3, 3].double()
    points = splats.means[ids].double() @ rotation.T + translation
    opacities = splats.opacities[ids].double()
    axes = rotation @ _rotations(splats.quats[ids].double())
    factor = _jacobians(points, camera) @ (axes * splats.scales[ids].double()[:, None, :])
    cov = factor @ factor.mT
    a, b, c = cov[:, 0, 0] + settings.eps2d, cov[:, 0, 1], cov[:, 1, 1] + settings.eps2d
    # det(F Fᵀ + eps I) by Cauchy-Binet; a·c − b² would cancel for needles.
    cross: Tensor = torch.linalg.cross(factor[:, 0], factor[:, 1])
    det = (cross**2).sum(dim=1) + settings.eps2d * (factor**2).sum(dim=(1, 2)) + settings.eps2d**2
    centers = points[:, :2] / points[:, 2:] * points.new_tensor((camera.fx, camera.fy))
    centers = centers + points.new_tensor((camera.cx, camera.cy))

    with torch.no_grad():
        reach = 2.0 * torch.log(opacities / settings.alpha_min)
        radii, visible = _footprints(a, b, c, det, centers, reach, camera)
        _check_isects(a, c, centers, reach, visible, camera, settings)
        depths = points[:, 2].detach()
        order = torch.argsort(depths.float(), stable=True)
        order = order[visible[order]]
        all_radii = torch.zeros(len(splats.means), dtype=torch.int32)
        all_radii[ids] = radii
    a, b, c, det = a[order], b[order], c[order], det[order]
    zeros = torch.zeros_like(a)
    whiten = torch.stack((c / (c * det).sqrt(), -b / (c * det).sqrt(), zeros, 1.0 / c.sqrt()), dim=1).reshape(-1, 2, 2)
    ids = ids[order]
    return (
        _Projected(ids, centers[order], whiten, points[order, 2], opacities[order], splats.features[ids].double()),
        all_radii,
    )


def _rotations(quats: Tensor) -> Tensor:
    """Rotations [V, 3, 3] from w x y z, prescaled for extreme lengths like 1e-30."""
    quats = quats / quats.detach().abs().amax(dim=1, keepdim=True)
    w, x, y, z = (quats / quats.norm(dim=1, keepdim=True)).unbind(dim=1)
    rows = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return torch.stack(rows, dim=1).reshape(-1, 3, 3)


def _jacobians(points: Tensor, camera: Camera) -> Tensor:
    """Jacobians [V, 2, 3] of the projection, with gsplat's off-axis direction clamp."""
    x, y, z = points.unbind(dim=1)
    margin_x, margin_y = 0.15 * camera.width / camera.fx, 0.15 * camera.height / camera.fy
    low_x, high_x = -camera.cx / camera.fx - margin_x, (camera.width - camera.cx) / camera.fx + margin_x
    low_y, high_y = -camera.cy / camera.fy - margin_y, (camera.height - camera.cy) / camera.fy + margin_y
    u, v = (x / z).clamp(low_x, high_x), (y / z).clamp(low_y, high_y)
    zero = torch.zeros_like(z)
    rows = (camera.fx / z, zero, -camera.fx * u / z, zero, camera.fy / z, -camera.fy * v / z)
    return torch.stack(rows, dim=1).reshape(-1, 2, 3)


def _footprints(
    a: Tensor, b: Tensor, c: Tensor, det: Tensor, centers: Tensor, reach: Tensor, camera: Camera
) -> tuple[Tensor, Tensor]:
    """Returns radii int32 [V] and whether a pixel center lies in the footprint's box."""
    largest = 0.5 * (a + c) + (0.25 * (a - c) ** 2 + b * b).sqrt()
    radii = (reach * largest).sqrt().clamp(max=_MAX_RADIUS).ceil().clamp(min=1.0)
    visible = torch.isfinite(radii) & torch.isfinite(centers).all(dim=1) & (det > 0) & torch.isfinite(det)
    for axis, (variance, size) in enumerate(((a, camera.width), (c, camera.height))):
        half = (reach * variance).sqrt()
        first = (centers[:, axis] - half - 0.5).ceil().clamp(min=0)
        last = (centers[:, axis] + half - 0.5).floor().clamp(max=size - 1)
        visible &= first <= last
    return torch.where(visible, radii, 0.0).to(torch.int32), visible


def _check_isects(
    a: Tensor, c: Tensor, centers: Tensor, reach: Tensor, visible: Tensor, camera: Camera, settings: RasterSettings
) -> None:
    """Counts the 16×16-pixel tiles that bounding boxes touch."""
    isects = torch.ones_like(a)
    for axis, (variance, size) in enumerate(((a, camera.width), (c, camera.height))):
        half = (reach * variance).sqrt()
        tiles = (size + _TILE - 1) // _TILE
        first = ((centers[:, axis] - half) / _TILE).floor().clamp(0, tiles - 1)
        last = ((centers[:, axis] + half) / _TILE).floor().clamp(0, tiles - 1)
        isects = isects * (last - first + 1)
    total = int(isects[visible].sum())
    if total > settings.max_isects:
        raise isect_limit_error(settings.max_isects)


def _pixel_chunks(camera: Camera, gaussians: int) -> list[Tensor]:
    """Splits pixel centers, row-major, into [P, 2] chunks that bound the dense matrix."""
    y, x = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
    centers = torch.stack((x, y), dim=-1).reshape(-1, 2).double() + 0.5
    return list(torch.split(centers, max(1, _CHUNK // max(1, gaussians))))


def _weights(projected: _Projected, pixels: Tensor, settings: RasterSettings) -> tuple[Tensor, Tensor, Tensor]:
    """Returns blend weights [P, V], transmittance [P, V + 1], and transmittance before each Gaussian."""
    offsets = pixels[:, None, :] - projected.centers[None]
    white = torch.einsum("vij,pvj->pvi", projected.whiten, offsets)
    alpha = projected.opacities * torch.exp(-0.5 * (white * white).sum(dim=-1))
    drawn = torch.where(alpha < settings.alpha_min, 0.0, alpha.clamp(max=settings.alpha_max))
    unit = torch.ones(len(pixels), 1, dtype=torch.float64)
    running = torch.cat((unit, torch.cumprod(1.0 - drawn, dim=1)), dim=1)
    # Transmittance never rises, so everything behind the Gaussian that would cross the limit is dropped as well.
    going = running[:, 1:] > settings.transmittance_min
    drawn = torch.where(going, drawn, 0.0)
    transmittance = torch.cat((unit, torch.cumprod(1.0 - drawn, dim=1)), dim=1)
    return drawn * transmittance[:, :-1], transmittance, transmittance[:, :-1]
