"""Furniture, plants and what stands on floors, in meters."""

from __future__ import annotations

import numpy as np

from benchmarks.rooms.materials import mottled, painted, plain
from benchmarks.rooms.models.tableware import GLAZES, Random, grained, pick, steel
from benchmarks.rooms.shapes import Meshes, ball, board, box, curve, grid, lathe, part, placed, sheet, tube
from demo.sample_paint import cloth, print_landscape, print_shapes


def table(rng: Random, size: tuple[float, float, float]) -> Meshes:
    """A top on four legs; `size` is that of the whole."""
    x, y, z = size
    wood = grained(rng)
    legs = grained(rng, 2)
    inset = 0.06
    feet = [(a * (x / 2 - inset), b * (y / 2 - inset)) for a in (-1, 1) for b in (-1, 1)]
    under = [mesh for a, b in feet for mesh in box((0.055, 0.055, z - 0.035), legs, (a, b, (z - 0.035) / 2))]
    return [*box((x, y, 0.035), wood, (0, 0, z - 0.0175)), *part("legs", under)]


def chair(rng: Random) -> Meshes:
    """Of wood, with a back of slats."""
    wood = grained(rng, 2)
    seat = placed([ball((0.215, 0.205, 0.02), plain(pick(rng, GLAZES), 0.04), boxy=0.3)], z=0.45)
    legs = [mesh for x in (-0.18, 0.18) for mesh in box((0.038, 0.038, 0.44), wood, (x, -0.17, 0.22))]
    posts = [tube([(x, 0.18, 0), (x, 0.185, 0.44), (x, 0.235, 0.92)], 0.02, wood) for x in (-0.18, 0.18)]
    rails = [
        mesh
        for z, y in ((0.6, 0.202), (0.72, 0.214), (0.85, 0.228))
        for mesh in box((0.36, 0.018, 0.055), wood, (0, y, z))
    ]
    bars = [tube([(-0.18, y, 0.2), (0.18, y, 0.2)], 0.011, wood) for y in (-0.17, 0.182)]
    return [*part("seat", seat), *part("legs", [*legs, *bars]), *part("back", [*posts, *rails])]


def stool(rng: Random) -> Meshes:
    """A round seat on three legs."""
    seat = lathe([(0, 0.42), (0.16, 0.42), (0.17, 0.435), (0.165, 0.455), (0, 0.46)], grained(rng))
    turns = (0.4, 0.4 + 2 * np.pi / 3, 0.4 + 4 * np.pi / 3)
    legs = [
        tube(
            [(0.11 * np.cos(t), 0.11 * np.sin(t), 0.42), (0.19 * np.cos(t), 0.19 * np.sin(t), 0.0)],
            0.018,
            grained(rng, 2),
        )
        for t in turns
    ]
    return [*seat, *part("legs", legs)]


def couch(rng: Random) -> Meshes:
    """Two seats, with cushions of its own stuff."""
    stuff = mottled((pick(rng, ("#5a6b7a", "#7a5a4a", "#5f6f55", "#8a7a9a")),) * 2, 220, 0.0, uneven=0.5)
    base = [ball((0.75, 0.4, 0.15), stuff, (0, 0, 0.22), boxy=0.2)]
    back = [ball((0.75, 0.11, 0.25), stuff, (0, 0.32, 0.55), boxy=0.25)]
    arms = [ball((0.1, 0.4, 0.2), stuff, (side * 0.72, 0, 0.42), boxy=0.3) for side in (-1, 1)]
    seats = [ball((0.31, 0.3, 0.08), stuff, (side * 0.31, -0.06, 0.42), boxy=0.35) for side in (-1, 1)]
    return [*base, *part("back", back), *part("arms", arms), *part("cushions", seats)]


def cushion(rng: Random) -> Meshes:
    """Printed."""
    print_ = painted(print_shapes, 160, 160, int(rng.integers(1 << 30)))
    return placed([ball((0.2, 0.2, 0.07), print_, boxy=0.55)], z=0.2, tip=1.2)


def plant(rng: Random) -> Meshes:
    """Leaves in a clay pot."""
    clay = mottled(("#b5532f", "#d0683c", "#c25c35", "#dc8458"), 40, 1.0)
    pot = lathe(
        [(0, 0), (0.045, 0), (0.048, 0.004), (0.062, 0.085), (0.069, 0.086), (0.07, 0.108), (0.063, 0.11)], clay
    )
    soil = lathe([(0.063, 0.1), (0, 0.102)], mottled(("#2a1d14", "#4a3524", "#241910"), 260, 1.4))
    greens = [
        mottled(tones, 60, 1.0, 0.05, 25)
        for tones in (("#2f6a35", "#4a8f46"), ("#3b7d3c", "#6bab52"), ("#5a9c44", "#98c868"))
    ]
    stem = plain("#5c6b39")
    leaves: Meshes = []
    for k in range(34):
        turn, high = k * 2.399963, k / 33  # the golden angle spreads leaves evenly
        out = np.array([np.cos(turn), np.sin(turn), 0.0])
        foot = 0.014 * out + (0, 0, 0.1)
        knee = foot + out * 0.06 * (1.25 - high) + (0, 0, 0.03 + 0.16 * high + float(rng.uniform(-0.012, 0.012)))
        leaves.append(tube(curve([foot, 0.5 * (foot + knee) + (0, 0, 0.015), knee], 6), 0.0018, stem, sides=6))
        t, s = np.linspace(0, 1, 10)[:, None], np.linspace(-1, 1, 5)
        length = float(rng.uniform(0.08, 0.12)) * (1.1 - 0.3 * high)
        rise = 0.2 + 1.0 * high - 1.5 * t
        width = 0.28 * length * np.sin(np.pi * np.clip(t, 0.02, 0.99) ** 0.8) ** 0.8
        forward, upward = np.cumsum(np.cos(rise) * length / 9, axis=0), np.cumsum(np.sin(rise) * length / 9, axis=0)
        points = knee + forward[..., None] * out + (s * width)[..., None] * np.array([-out[1], out[0], 0.0])
        points = points + np.stack([0 * s * t, 0 * s * t, upward + 0.25 * width * s**2], axis=-1)
        leaves.append(grid(points, greens[int(rng.integers(3))]))
    return [*part("pot", [*pot, *soil]), *part("leaves", leaves)]


def rug(rng: Random, size: tuple[float, float]) -> Meshes:
    """Printed cloth, a few millimeters thick; also a place mat."""
    x, y = size[0] / 2, size[1] / 2
    rows, columns = (int(700 * side / max(size)) for side in (size[1], size[0]))
    printed = painted(cloth, rows, columns, int(rng.integers(1 << 30)))
    top = sheet([(-x, -y, 0.0036), (x, -y, 0.0036), (x, y, 0.0036), (-x, y, 0.0036)], printed, cells=8)
    return [*board((size[0], size[1], 0.003), plain("#d9ceb4")), top]


def bucket(rng: Random) -> Meshes:
    """Hollow, with a wire handle."""
    color = plain(pick(rng, GLAZES), 0.06, 40)
    outside = lathe([(0, 0), (0.1, 0), (0.135, 0.24), (0.14, 0.243), (0.133, 0.246)], color, sides=40)
    inside = lathe([(0.131, 0.243), (0.097, 0.006), (0, 0.006)], color, sides=40)
    angle = np.linspace(0, np.pi, 26)
    wire = np.stack([0.137 * np.cos(angle), -0.1 * np.sin(angle), 0.225 + 0.075 * np.sin(angle)], axis=1)
    return [*outside, *inside, *part("handle", [tube(wire, 0.004, steel())])]


def floor_lamp(rng: Random) -> Meshes:
    """A foot, a pole and a shade."""
    foot = lathe([(0, 0), (0.13, 0), (0.135, 0.015), (0, 0.03)], plain("#232427", 0.07))
    pole = [tube([(0, 0, 0.02), (0, 0, 1.3)], 0.012, steel(2))]
    shade = lathe(
        [(0.19, 1.15), (0.12, 1.42), (0.117, 1.42), (0.186, 1.15)],
        plain(pick(rng, ("#efe3c8", "#d9b48f", "#b9c6a2")), 0.02),
    )
    return [*foot, *pole, *part("shade", shade)]


def cabinet(rng: Random, size: tuple[float, float, float]) -> Meshes:
    """A box with two drawers and knobs."""
    x, y, z = size
    wood, front = grained(rng), grained(rng)
    fronts: Meshes = []
    for k in (0, 1):
        middle = z * (0.27 + 0.46 * k)
        fronts += box((0.92 * x, 0.014, 0.4 * z), front, (0, -y / 2 - 0.007, middle))
        fronts.append(ball((0.016, 0.016, 0.016), plain("#c9983e", 0.1, 60), (0, -y / 2 - 0.03, middle)))
    return [*board(size, wood), *part("drawers", fronts)]


def shelf(rng: Random, size: tuple[float, float, float], boards: int) -> Meshes:
    """Two sides and some boards, open in front; its back is the wall's."""
    x, y, z = size
    wood, thick = grained(rng), 0.022
    meshes = [mesh for side in (-1, 1) for mesh in box((thick, y, z), wood, (side * (x - thick) / 2, 0, z / 2))]
    for height in shelf_heights(z, boards):
        meshes += box((x - 2 * thick, y, thick), wood, (0, 0, height - thick / 2))
    return meshes


def shelf_heights(height: float, boards: int) -> list[float]:
    """Tops of a shelf's boards, the lowest near the floor, the highest at the end of the sides."""
    return [float(top) for top in np.linspace(0.05, height, boards)]


def framed_print(rng: Random) -> Meshes:
    """For a wall; its back at y = 0, its middle at z = 0."""
    width, height = (0.4, 0.3) if rng.uniform() < 0.5 else (0.3, 0.4)
    draw = print_landscape if rng.uniform() < 0.5 else print_shapes
    art = painted(draw, int(700 * height), int(700 * width), int(rng.integers(1 << 30)), gloss=0.05, polish=80)
    x, z = width / 2, height / 2
    print_ = sheet([(-x, -0.0262, -z), (x, -0.0262, -z), (x, -0.0262, z), (-x, -0.0262, z)], art)
    frame = box(
        (width + 0.04, 0.025, height + 0.04),
        plain(pick(rng, ("#3a2618", "#1d1d1f", "#c9a36a")), 0.05, 30),
        (0, -0.0135, 0),
    )
    return [*frame, *part("picture", [print_])]
