"""Photos of drawn rooms, with exact ids of objects and parts, and with the faults of a phone's photos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.rooms.lighting import Light
from benchmarks.rooms.materials import F32
from benchmarks.rooms.rasterizing import Soup, corner_shares, projected_into, rasterized
from benchmarks.rooms.shapes import F64, Ints, Mesh
from fastsplat_contract.geometry.camera import PosedCamera

_STEPS = 2
_BRIGHT, _DARK = np.array([0.95, 0.97, 1.0]), np.array([0.16, 0.14, 0.12])
"""What mirrors show of the room that is not drawn: bright above, dark below."""
_LARGEST_EV, _LARGEST_BALANCE = 1.2, 0.06
_EXPOSURE = 0.8


@dataclass(frozen=True)
class Picture:
    """A view of a room.

    Attributes:
        light: float32 [H, W, 3], linear RGB.
        triangle: int64 [H, W], what the center of each pixel shows; -1 for nothing.
        nearness: float64 [H, W], 1 / depth at the center of each pixel, 0 for nothing.
    """

    light: F32
    triangle: NDArray[np.int64]
    nearness: F64


@dataclass(frozen=True)
class Faults:
    """What a phone does to a photo: exposure in powers of two, gains of red, green and blue, blur's standard deviation
    in pixels, the share of light that corners lose, and noise."""

    ev: float = 0.0
    balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    blur: float = 0.0
    vignette: float = 0.0
    noise: bool = False


EVEN = Faults()


def phone_faults(rng: np.random.Generator) -> Faults:
    """Faults of one photo: exposure within ±1.2 EV, balance within ±6 %, slight blur, vignette and noise."""
    red, blue = rng.uniform(-_LARGEST_BALANCE, _LARGEST_BALANCE, 2)
    return Faults(
        ev=float(rng.uniform(-_LARGEST_EV, _LARGEST_EV)),
        balance=(1 + float(red), 1.0, 1 + float(blue)),
        blur=float(rng.uniform(0.0, 0.6)),
        vignette=float(rng.uniform(0.08, 0.2)),
        noise=True,
    )


def photo_of(light: F32, faults: Faults, rng: np.random.Generator) -> NDArray[np.uint8]:
    """uint8 [H, W, 3], sRGB, of linear light [H, W, 3]."""
    height, width = light.shape[:2]
    y, x = np.mgrid[0:height, 0:width]
    corner = ((x + 0.5 - width / 2) ** 2 + (y + 0.5 - height / 2) ** 2) / (width**2 + height**2) * 4
    seen = light * np.float32(_EXPOSURE * 2**faults.ev) * np.asarray(faults.balance, np.float32)
    seen = seen * (1 - faults.vignette * corner**2)[..., None].astype(np.float32)
    if faults.blur > 0.05:
        seen = cv2.GaussianBlur(seen, (0, 0), faults.blur)
    if faults.noise:
        deviation = np.sqrt(np.maximum(seen, 0) * 1.2e-4 + 4e-6)
        seen = seen + deviation * rng.standard_normal(seen.shape, dtype=np.float32)
    clipped = np.clip(seen, 0, 1)
    coded = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    return np.asarray(np.round(coded * 255), np.uint8)


def picture_of(meshes: Sequence[Mesh], soup: Soup, light: Light, posed: PosedCamera) -> Picture:
    """The light that a camera sees of meshes (and their soup), smoothed at edges, and what its pixels' centers show."""
    projected, front, size = projected_into(soup, posed.camera, posed.camera_from_world(), _STEPS)
    hits = rasterized(projected, soup.triangles, front, size)
    rows, columns = np.nonzero(hits.triangle >= 0)
    triangle = hits.triangle[rows, columns]
    corners = soup.triangles[triangle]
    shares = corner_shares(projected, corners, columns.astype(float), rows.astype(float))
    points, normals, local = (_mixed(shares, corners, values) for values in (soup.points, soup.normals, soup.local))
    uv = _mixed(shares, corners, soup.uv)
    away = posed.world_from_camera[:3, 3] - points
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    normals = np.where((normals * away).sum(axis=1, keepdims=True) < 0, -normals, normals)
    colors = np.zeros((*hits.triangle.shape, 3), np.float32)
    owner = soup.mesh[triangle]
    once, all_of = _alike(rows, columns, owner, hits.triangle.shape[1])
    falling = light.reaching(points[once], normals[once])[all_of]
    colors[rows, columns] = _shaded(meshes, owner, falling, normals, away, local, uv, light.window)
    return Picture(_smoothed(colors), hits.triangle[1::2, 1::2], hits.nearness[1::2, 1::2])


def _alike(rows: Ints, columns: Ints, owner: Ints, width: int) -> tuple[Ints, Ints]:
    """One sample of each mesh in each pixel, and for each sample the place of the one that stands for it: light changes
    less than colors do."""
    pixel = rows // _STEPS * width + columns // _STEPS
    _, once, all_of = np.unique(pixel * (int(owner.max(initial=0)) + 1) + owner, return_index=True, return_inverse=True)
    return once, all_of


def _mixed(shares: F64, corners: NDArray[np.int64], values: F64) -> F64:
    return np.asarray(sum(shares[:, k, None] * values[corners[:, k]] for k in range(3)))


def _shaded(
    meshes: Sequence[Mesh],
    owner: Ints,
    falling: F32,
    normals: F64,
    away: F64,
    local: F64,
    uv: F64,
    window: F64,
) -> F32:
    mirrored = 2 * (normals * away).sum(axis=1, keepdims=True) * normals - away
    level = np.clip(0.5 + 0.7 * mirrored[:, 2:], 0, 1)
    around = (_DARK + level * (_BRIGHT - _DARK)).astype(np.float32) * falling.mean(axis=1, keepdims=True)
    gleam = np.maximum(mirrored @ window, 0)
    grazing = (1 - np.clip((normals * away).sum(axis=1), 0, 1)) ** 5
    colors = np.zeros_like(falling)
    order = np.argsort(owner, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(owner[order])) + 1):
        material = meshes[int(owner[rows[0]])].material
        color = material.color(local[rows].astype(np.float32), uv[rows].astype(np.float32))
        highlight = (material.polish / 12 * gleam[rows] ** material.polish)[:, None].astype(np.float32)
        mirror = around[rows] + highlight * np.minimum(falling[rows], 1.0)
        if material.metal:
            colors[rows] = color * (0.35 * falling[rows] + 0.75 * mirror)
        else:
            share = (material.gloss + (1 - material.gloss) * material.gloss * 4 * grazing[rows])[:, None]
            colors[rows] = color * falling[rows] + share.astype(np.float32) * mirror
    return colors


def _smoothed(samples: F32) -> F32:
    """Pixels of samples at their centers and edges, by a tent one pixel to each side of half its height."""
    rows = 0.25 * samples[:-1:2] + 0.5 * samples[1::2] + 0.25 * samples[2::2]
    return np.asarray(0.25 * rows[:, :-1:2] + 0.5 * rows[:, 1::2] + 0.25 * rows[:, 2::2], np.float32)
