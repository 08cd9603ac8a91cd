"""Meshes that drawn objects are made of. Meters, z up; an object stands on z = 0 and faces -y."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks.rooms.materials import Material

F64 = NDArray[np.float64]
Ints = NDArray[np.int64]

_SHARP = np.radians(35)
"""Profiles that turn by more have an edge there."""


@dataclass(frozen=True)
class Mesh:
    """A surface of one material.

    Attributes:
        points, normals: float64 [N, 3], in the room once it is placed; normals may point to either side.
        local: float64 [N, 3], where the points were before the object was placed: what its grain is painted by.
        uv: float64 [N, 2], 0..1, of pictures.
        triangles: int64 [T, 3].
        material: see `Material`.
        part: of its object, "" for none.
    """

    points: F64
    normals: F64
    local: F64
    uv: F64
    triangles: Ints
    material: Material
    part: str = ""


Meshes = list[Mesh]


def part(name: str, meshes: Iterable[Mesh]) -> Meshes:
    """The same meshes as a part of their object."""
    return [replace(mesh, part=name) for mesh in meshes]


def placed(
    meshes: Iterable[Mesh],
    x: float = 0.0,
    y: float = 0.0,
    turn: float = 0.0,
    z: float = 0.0,
    *,
    tip: float = 0.0,
    roll: float = 0.0,
    scale: float = 1.0,
) -> Meshes:
    """Rolled about y, tipped about x, turned about z, all in radians, then moved."""
    rotation = rotated("z", turn) @ rotated("x", tip) @ rotated("y", roll)
    return [
        replace(mesh, points=scale * mesh.points @ rotation.T + (x, y, z), normals=mesh.normals @ rotation.T)
        for mesh in meshes
    ]


def rotated(axis: str, angle: float) -> F64:
    """float64 [3, 3]: a rotation about an axis, radians."""
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    turn = np.eye(3)
    turn[first, first] = turn[second, second] = np.cos(angle)
    turn[first, second], turn[second, first] = -np.sin(angle), np.sin(angle)
    return turn


def resting(meshes: Sequence[Mesh], height: float = 0.0) -> Meshes:
    """The same meshes moved up or down until their lowest point is at `height`."""
    lowest = min(float(mesh.points[:, 2].min()) for mesh in meshes)
    return placed(meshes, z=height - lowest)


def curve(control: ArrayLike, count: int) -> F64:
    """Catmull-Rom curve through control points [K, D], sampled evenly in its parameter: [count, D]."""
    p = np.asarray(control, float)
    p = np.concatenate([2 * p[:1] - p[1:2], p, 2 * p[-1:] - p[-2:-1]])
    t = np.linspace(0, len(p) - 3 - 1e-9, count)
    i, s = t.astype(int), (t % 1)[:, None]
    a, b, c, d = p[i], p[i + 1], p[i + 2], p[i + 3]
    return np.asarray(0.5 * (2 * b + (c - a) * s + (2 * a - 5 * b + 4 * c - d) * s**2 + (3 * b - a - 3 * c + d) * s**3))


def grid(points: ArrayLike, material: Material, *, wrap: bool = False) -> Mesh:
    """A smooth surface through points [A, B, 3], uv = (b, a); `wrap` joins the ends of B."""
    p = np.asarray(points, float)
    if wrap:
        p = np.concatenate([p, p[:, :1]], axis=1)
    along, across = np.gradient(p, axis=0), np.gradient(p, axis=1)
    if wrap:
        across[:, 0] = across[:, -1] = p[:, 1] - p[:, -2]
    normals = np.cross(across, along)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-15)
    rows, columns = p.shape[:2]
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    below = np.stack([corner, corner + 1, corner + columns + 1], axis=1)
    above = np.stack([corner, corner + columns + 1, corner + columns], axis=1)
    u, v = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
    flat = p.reshape(-1, 3)
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    return Mesh(flat, normals.reshape(-1, 3), flat, uv, np.concatenate([below, above]), material)


def lathe(profile: ArrayLike, material: Material, *, sides: int = 36, count: int = 0) -> Meshes:
    """Surfaces of revolution about z from a profile [K, 2] of (radius, height): splined to `count` points if that is
    stated, else with an edge wherever it turns sharply."""
    outline = np.asarray(profile, float)
    runs = [curve(outline, count)] if count else _smooth_runs(outline)
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    meshes = []
    for run in runs:
        r, z = np.maximum(run[:, :1], 1e-5), run[:, 1:]
        rings = np.stack([r * np.cos(angle), r * np.sin(angle), z + 0 * angle], axis=-1)
        meshes.append(grid(rings, material, wrap=True))
    return meshes


def _smooth_runs(outline: F64) -> list[F64]:
    steps = np.diff(outline, axis=0)
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    turn = np.abs((np.diff(heading) + np.pi) % (2 * np.pi) - np.pi)
    cuts = [0, *(np.flatnonzero(turn > _SHARP) + 1).tolist(), len(outline) - 1]
    return [outline[first : last + 1] for first, last in pairwise(cuts)]


def ball(
    radii: Sequence[float],
    material: Material,
    center: Sequence[float] = (0, 0, 0),
    turn: Sequence[float] = (0, 0, 0),
    *,
    boxy: float = 1.0,
) -> Mesh:
    """An ellipsoid with these half axes, turned about x, y and z; `boxy` towards 0 makes it a box with round edges."""
    theta, phi = np.linspace(1e-4, np.pi - 1e-4, 22), np.linspace(0, 2 * np.pi, 32, endpoint=False)
    s, c = np.sin(theta)[:, None], np.cos(theta)[:, None]
    unit = np.stack([s * np.cos(phi), s * np.sin(phi), c + 0 * phi], axis=-1)
    if boxy < 1:
        unit = np.stack(
            [
                _powered(s, boxy) * _powered(np.cos(phi), boxy),
                _powered(s, boxy) * _powered(np.sin(phi), boxy),
                _powered(c, boxy) + 0 * phi,
            ],
            axis=-1,
        )
    rotation = rotated("z", turn[2]) @ rotated("y", turn[1]) @ rotated("x", turn[0])
    return grid((unit * np.asarray(radii, float))[::-1] @ rotation.T + np.asarray(center, float), material, wrap=True)


def _powered(values: F64, power: float) -> F64:
    return np.asarray(np.sign(values) * np.abs(values) ** power)


def tube(path: ArrayLike, radius: ArrayLike, material: Material, *, sides: int = 12, squash: float = 1.0) -> Mesh:
    """A round tube along a path [K, 3] with a radius, or one a point; `squash` flattens it across."""
    p = np.asarray(path, float)
    r = np.broadcast_to(np.asarray(radius, float), len(p))
    tangent = np.gradient(p, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent[0], (0.31, 0.2, 0.93) if abs(tangent[0][2]) < 0.9 else (0.0, 1.0, 0.0))
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)[:, None]
    rings = []
    for k in range(len(p)):  # parallel transport: the ring never twists
        side = side - tangent[k] * (side @ tangent[k])
        side /= np.linalg.norm(side)
        binormal = np.cross(tangent[k], side)
        rings.append(p[k] + r[k] * (np.cos(angle) * side + squash * np.sin(angle) * binormal))
    ends = [p[k] + 1e-4 * (rings[k] - p[k]) for k in (0, -1)]
    return grid(np.stack([ends[0], *rings, ends[1]]), material, wrap=True)


def ring(radius: float, thickness: float, material: Material, center: Sequence[float] = (0, 0, 0)) -> Mesh:
    """A torus that lies flat."""
    angle = np.linspace(0, 2 * np.pi, 33)
    path = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)
    return tube(path + np.asarray(center, float), thickness, material, sides=10)


def sheet(corners: ArrayLike, material: Material, cells: int = 1) -> Mesh:
    """A flat piece; corners [4, 3]: bottom left, bottom right, top right, top left of a picture on it."""
    c = np.asarray(corners, float)
    v, u = np.linspace(0, 1, cells + 1)[:, None, None], np.linspace(0, 1, cells + 1)[None, :, None]
    return grid((1 - v) * ((1 - u) * c[0] + u * c[1]) + v * ((1 - u) * c[3] + u * c[2]), material)


def box(size: Sequence[float], material: Material, center: Sequence[float] = (0, 0, 0)) -> Meshes:
    """A box with a picture, if the material is one, on each of its six faces."""
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    meshes = []
    for axis, (u, v) in enumerate(((1, 2), (0, 2), (0, 1))):
        for side in (-1.0, 1.0):
            corners = np.empty((4, 3))
            flip = -1.0 if (side > 0) == (axis == 1) else 1.0
            corners[:, axis], corners[:, u], corners[:, v] = side, flip * signs[:, 0], signs[:, 1]
            meshes.append(sheet(0.5 * corners * np.asarray(size, float) + np.asarray(center, float), material))
    return meshes


def board(size: Sequence[float], material: Material) -> Meshes:
    """A box that stands on z = 0."""
    return box(size, material, (0, 0, size[2] / 2))


def bar(path: ArrayLike, half: ArrayLike, thickness: float, material: Material, base: float = 0.0) -> Meshes:
    """A flat bar of metal or wood along a path [K, 2] in the plane, of half a width, or one a point; it lies from
    `base` up."""
    p = np.asarray(path, float)
    h = np.broadcast_to(np.asarray(half, float), len(p))[:, None]
    step = np.gradient(p, axis=0)
    across = np.stack([-step[:, 1], step[:, 0]], axis=1) / np.linalg.norm(step, axis=1, keepdims=True)
    edges = [p + h * across, p - h * across]
    levels = (base, base + thickness)

    def at(edge: F64, level: float) -> F64:
        return np.concatenate([edge, np.full((len(p), 1), level)], axis=1)

    strips = [np.stack([at(edges[0], level), at(edges[1], level)], axis=1) for level in levels]
    strips += [np.stack([at(edge, levels[0]), at(edge, levels[1])], axis=1) for edge in edges]
    ends = [np.stack([np.stack([at(e, level)[k] for e in edges]) for level in levels]) for k in (0, -1)]
    return [grid(strip, material) for strip in (*strips, *ends)]
