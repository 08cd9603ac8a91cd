"""Chooses poses around and within a splat from which pictures of it are good."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.splat_import.bulk import F64, Bulk
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.raster.rendering import accumulate_weights
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera
from fastsplat_contract.geometry.poses import look_at
from fastsplat_contract.jobs.operations import UpAxis

_RINGS = ((12.0, 2.8), (30.0, 2.8), (30.0, 2.0), (55.0, 2.4))
"""Elevation above the bulk's center, degrees, and distance from it in bulk radii."""
_RING_VIEWS = 12
_INNER_PLACES = 6
_INNER_VIEWS = 8
_INNER_PITCH_DEG = -12.0
_INNER_TRIALS = 400
_FREE = 0.3  # radii of the bulk to the next matter
_SOLID = 0.5
_TRIAL_SIDE = 96
_NEAR = 0.25  # radii of the bulk: matter that is nearer hides the rest
_BLOB = 0.12  # of the picture's width: a standard deviation that is larger shows no form
_ROWS = 60_000
_WORST = 0.2  # share of the best view's quality; worse views are dropped

OnTrial = Callable[[int, int], None]
"""Hears the index of each candidate and their number; may raise `CancelledError`."""

_SAMPLE = 100_000
_DIRECTIONS = 1_500
_ALIGNED = float(np.cos(np.radians(20)))
_FLAT = 0.5
_LARGE_SHARE = 0.95
_REACH = 3.0  # radii of the bulk within which surfaces count
_PEAKS = 4
_SLABS = 64
_CUSTOMARY = np.array([[0.0, 0, 1], [0, -1, 0], [0, 1, 0]])
"""Usual up axes: +z (nerfstudio), −y (COLMAP, 3DGS: first camera), +y (viewers)."""
_CUSTOM_WEIGHT = 1.0


@dataclass(frozen=True)
class _Trial:
    """A candidate pose, its quality (0 or more), and each sampled Gaussian's pixel share."""

    pose: F64
    quality: float
    seen: NDArray[np.float32]


@torch.no_grad()
def choose_viewpoints(
    gaussians: Gaussians,
    bulk: Bulk,
    up: F64,  # [3], unit vector
    count: int,
    field_of_view_deg: float,  # horizontal
    on_trial: OnTrial = lambda done, total: None,
    *,
    backend: Backend = "cpu",
) -> list[F64]:
    """Chooses up to `count` poses with good views, world_from_camera float64 [4, 4], OpenCV axes.

    Candidates lie on rings around the bulk and at free places within it. A small rendering of each is scored: matter
    and the bulk's core count for it, matter close to the lens and large blurry Gaussians against it. A greedy search
    maximizes Σ_g opacity_g · √(Σ_views quality · weight_g), so that everything is shown from several sides; outside
    the core, opacities count half.

    Raises:
        InvalidInputError: nothing can be seen from anywhere.
    """
    candidates = list(_candidates(gaussians, bulk, up))
    visible = np.flatnonzero(bulk.weights > 0)
    drawn = np.random.default_rng(0).permutation(visible)[:_ROWS]
    camera = trial_camera(field_of_view_deg)
    look = _Look(gaussians, bulk, drawn, camera, backend)
    trials = []
    for index, pose in enumerate(candidates):
        on_trial(index, len(candidates))
        trials.append(look.at(pose))
    best = max(trial.quality for trial in trials)
    if best <= 0:
        raise InvalidInputError(
            "nothing of the splat can be seen from around it or within",
            field="splat",
            hint="Send the photos that it was made of with their poses, as transforms.json or a COLMAP model.",
        )
    return [trial.pose for trial in _best_set([t for t in trials if t.quality >= _WORST * best], bulk, drawn, count)]


def trial_camera(field_of_view_deg: float, side: int = _TRIAL_SIDE) -> Camera:
    """Makes a camera of `side` × ¾ side pixels with a horizontal field of view."""
    height = round(0.75 * side)
    focal = side / 2 / np.tan(np.radians(field_of_view_deg) / 2)
    return Camera(side, height, float(focal), float(focal), side / 2, height / 2)


def _candidates(gaussians: Gaussians, bulk: Bulk, up: F64) -> Iterator[F64]:
    """Yields poses on the rings, then those at free places."""
    side = np.cross(up, [1.0, 0, 0] if abs(up[0]) < 0.9 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    forward = np.cross(up, side)
    for ring, (elevation_deg, distance) in enumerate(_RINGS):
        elevation = np.radians(elevation_deg)
        for index in range(_RING_VIEWS):
            azimuth = 2 * np.pi * (index + ring / len(_RINGS)) / _RING_VIEWS
            outward = np.cos(elevation) * (np.cos(azimuth) * side + np.sin(azimuth) * forward) + np.sin(elevation) * up
            yield look_at(bulk.center + distance * bulk.radius * outward, bulk.center, up)
    pitch = np.radians(_INNER_PITCH_DEG)
    for place in _free_places(gaussians, bulk, np.stack([side, forward, up])):
        for index in range(_INNER_VIEWS):
            yaw = 2 * np.pi * index / _INNER_VIEWS
            toward = np.cos(pitch) * (np.cos(yaw) * side + np.sin(yaw) * forward) + np.sin(pitch) * up
            yield look_at(place, place + toward, up)


def _free_places(gaussians: Gaussians, bulk: Bulk, axes: F64) -> F64:
    """Finds free places within the bulk, far from each other, float64 [P, 3]."""
    rng = np.random.default_rng(0)
    solid = np.flatnonzero(bulk.weights >= _SOLID * bulk.weights.max())
    solid = rng.permutation(solid)[: 2 * _ROWS]
    local = gaussians.means[solid].astype(np.float64) @ axes.T
    weights = bulk.weights[solid]
    bounds = np.quantile(local, [0.1, 0.9], axis=0, weights=weights, method="inverted_cdf")
    places = rng.uniform(bounds[0], bounds[1], (_INNER_TRIALS, 3))
    distance = cKDTree(local).query(places)[0]
    places, distance = places[free := distance > _FREE * bulk.radius], distance[free]
    chosen: list[int] = []
    while len(places) and len(chosen) < _INNER_PLACES:
        gaps = [np.linalg.norm(places - places[index], axis=1) for index in chosen]
        gap = np.min(gaps or [distance], axis=0)
        if chosen and gap.max() < _FREE * bulk.radius:
            break
        chosen.append(int(gap.argmax()))
    return np.asarray(places[chosen] @ axes)


class _Look:
    """Scores candidates by small renderings."""

    def __init__(
        self, gaussians: Gaussians, bulk: Bulk, drawn: NDArray[np.intp], camera: Camera, backend: Backend
    ) -> None:
        self._splats = splats_of(gaussians, device=device_of(backend))
        self._bulk, self._drawn, self._camera, self._backend = bulk, drawn, camera, backend
        self._means, self._widest = gaussians.means, np.exp(gaussians.log_scales.max(axis=1))
        self._every_pixel = torch.ones(camera.height, camera.width, 1, device=self._splats.means.device)

    def at(self, pose: F64) -> _Trial:
        viewmat = torch.from_numpy(np.linalg.inv(pose).astype(np.float32)).to(self._every_pixel.device)
        sums = accumulate_weights(self._splats, viewmat, self._camera, self._every_pixel, backend=self._backend)
        weight = sums[:, 0].cpu().numpy()
        rows = np.flatnonzero(weight > 0)
        pixels = self._camera.width * self._camera.height
        depth = (self._means[rows] - pose[:3, 3]) @ pose[:3, 2]
        near = depth < _NEAR * self._bulk.radius
        blob = self._widest[rows] * self._camera.fx > _BLOB * self._camera.width * np.maximum(depth, 1e-9)
        matter = float(weight[rows].sum()) / pixels
        hidden = float(weight[rows[near | blob]].sum()) / pixels
        core = float(weight[rows[self._bulk.core[rows]]].sum()) / pixels
        quality = max(0.0, matter - hidden) * (0.25 + core) * max(0.0, 1 - 2 * hidden)
        return _Trial(pose, quality, np.asarray(weight[self._drawn] / pixels, np.float32))


def _best_set(trials: list[_Trial], bulk: Bulk, drawn: NDArray[np.intp], count: int) -> list[_Trial]:
    importance = bulk.weights[drawn] * np.where(bulk.core[drawn], 1.0, 0.5)
    reached = np.zeros(len(drawn))
    left, chosen = list(trials), list[_Trial]()
    while left and len(chosen) < count:
        gains = [importance @ np.sqrt(reached + trial.quality * trial.seen) for trial in left]
        trial = left.pop(int(np.argmax(gains)))
        reached += trial.quality * trial.seen
        chosen.append(trial)
    return chosen


def axis_vector(axis: UpAxis) -> F64:
    """Turns an axis name into a unit vector, float64 [3]."""
    vector = np.zeros(3)
    vector["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return vector


def estimate_up(gaussians: Gaussians, bulk: Bulk) -> F64:
    """Estimates the unit vector that points up, float64 [3].

    The shortest axes of flat Gaussians, weighted by opacity and area, peak at the normals of floor, table and walls.
    The best peak has a high weight, more matter above its densest slab than below, and is near to a usual up axis.
    Rooms whose ceiling is better seen come out upside down, so users may state the axis.
    """
    near = np.linalg.norm(gaussians.means - bulk.center, axis=1) < _REACH * bulk.radius
    rows = np.flatnonzero(near & (bulk.weights > 0))
    if len(rows) > _SAMPLE:
        rows = np.random.default_rng(0).choice(rows, _SAMPLE, replace=False)
    scales = np.exp(np.sort(gaussians.log_scales[rows].astype(np.float64), axis=1))
    rows, scales = rows[flat := scales[:, 0] < _FLAT * scales[:, 1]], scales[flat]
    if not len(rows):
        return np.array([0.0, 0.0, 1.0])
    areas = scales[:, 1] * scales[:, 2]
    weights = bulk.weights[rows] * np.minimum(areas, np.quantile(areas, _LARGE_SHARE))
    normals = _normals(gaussians, rows)
    heights = gaussians.means.astype(np.float64)
    best, up = -1.0, np.array([0.0, 0.0, 1.0])
    for peak, vote in _peaks(normals, weights):
        aligned = np.abs(normals @ peak) > _ALIGNED
        slab = _densest(heights[rows[aligned]] @ peak, weights[aligned])
        for sign in (1.0, -1.0):
            along = sign * (heights @ peak - slab)
            thick = bulk.radius / 10
            above, below = (float(bulk.weights[near & side].sum()) for side in (along > thick, along < -thick))
            share = above / max(above + below, 1e-12)
            custom = max(0.0, float((_CUSTOMARY @ (sign * peak)).max()))
            score = vote * share * (1 + _CUSTOM_WEIGHT * custom)
            if score > best:
                best, up = score, sign * peak
    return up


def _peaks(normals: F64, weights: F64) -> list[tuple[F64, float]]:
    """Finds the most frequent normals, up to sign, and their weights."""
    index = np.arange(_DIRECTIONS) + 0.5  # half a Fibonacci sphere
    polar, azimuth = np.arccos(1 - index / _DIRECTIONS), np.pi * (1 + 5**0.5) * index
    directions = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)
    votes = np.array([weights[np.abs(normals @ direction) > _ALIGNED].sum() for direction in directions])
    peaks = []
    for _ in range(_PEAKS):
        top = int(votes.argmax())
        if votes[top] <= 0:
            break
        in_peak = np.abs(normals @ directions[top]) > _ALIGNED
        spread = (normals[in_peak] * weights[in_peak, None]).T @ normals[in_peak]
        axis = np.linalg.eigh(spread)[1][:, 2]  # principal direction of the peak's normals
        peaks.append((axis, float(votes[top])))
        votes[np.abs(directions @ directions[top]) > np.cos(np.radians(30))] = 0
    return peaks


def _densest(heights: F64, weights: F64) -> float:
    """Finds the height of the slab with most weight."""
    low, high = np.quantile(heights, [0.02, 0.98], weights=weights, method="inverted_cdf")
    if high <= low:
        return float(low)
    sums, edges = np.histogram(heights, bins=_SLABS, range=(float(low), float(high)), weights=weights)
    top = int(sums.argmax())
    return float(edges[top] + edges[top + 1]) / 2


def _normals(gaussians: Gaussians, rows: NDArray[np.intp]) -> F64:
    """Shortest axis of each Gaussian in the world, float64 [K, 3]."""
    shortest = np.eye(3)[gaussians.log_scales[rows].argmin(axis=1)]
    return np.asarray(Rotation.from_quat(gaussians.quats[rows].astype(float), scalar_first=True).apply(shortest))
