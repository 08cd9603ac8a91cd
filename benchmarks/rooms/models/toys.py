"""Toys and wares, in meters."""

from __future__ import annotations

import numpy as np

from benchmarks.rooms.materials import Material, linear, mottled, painted, plain, worded
from benchmarks.rooms.models.tableware import GLAZES, Random, pick
from benchmarks.rooms.shapes import Meshes, ball, board, box, curve, lathe, part, placed, ring, tube
from demo.sample_paint import hex_rgb

_BRIGHT = ("#d8322c", "#f2c230", "#2f78c4", "#3aa655", "#f08a24", "#8a4aa0", "#e86a9a")


def teddy(rng: Random) -> Meshes:
    """A sitting plush bear with a ribbon."""
    tones = (("#8f6238", "#ad7b48", "#c08f5e"), ("#6b5a4a", "#8a7866", "#a08f7c"), ("#c9b59a", "#e0d0b8", "#efe3cf"))
    coat = mottled(tones[int(rng.integers(3))], 260, 1.4)
    light, black = mottled(("#dcc09a", "#ecd8b8"), 200, 1.2), plain("#15100e", 0.1, 60)
    shapes = (
        ((0.058, 0.05, 0.066), (0, 0, 0.064), 0, 0, coat),
        ((0.053, 0.049, 0.048), (0, -0.006, 0.16), 0, 0, coat),
        ((0.02, 0.01, 0.02), (-0.041, 0.0, 0.202), 0, -0.4, coat),
        ((0.02, 0.01, 0.02), (0.041, 0.0, 0.202), 0, 0.4, coat),
        ((0.02, 0.02, 0.045), (-0.066, -0.02, 0.087), -0.5, 0.55, coat),
        ((0.02, 0.02, 0.045), (0.066, -0.02, 0.087), -0.5, -0.55, coat),
        ((0.026, 0.05, 0.025), (-0.045, -0.062, 0.026), 0, 0, coat),
        ((0.026, 0.05, 0.025), (0.045, -0.062, 0.026), 0, 0, coat),
        ((0.04, 0.02, 0.045), (0, -0.036, 0.064), 0, 0, light),
        ((0.024, 0.022, 0.019), (0, -0.05, 0.148), 0, 0, light),
        ((0.018, 0.006, 0.018), (-0.045, -0.11, 0.026), 0, 0, light),
        ((0.018, 0.006, 0.018), (0.045, -0.11, 0.026), 0, 0, light),
        ((0.0095, 0.006, 0.0065), (0, -0.0735, 0.155), 0, 0, black),
        ((0.0065, 0.005, 0.0065), (-0.02, -0.051, 0.172), 0, 0, black),
        ((0.0065, 0.005, 0.0065), (0.02, -0.051, 0.172), 0, 0, black),
    )
    meshes = [ball(radii, material, center, (tip, roll, 0)) for radii, center, tip, roll, material in shapes]
    ribbon = plain(pick(rng, _BRIGHT), 0.04)
    bow = [ball((0.018, 0.007, 0.011), ribbon, (side * 0.018, -0.05, 0.116), (0, side * 0.3, 0)) for side in (-1, 1)]
    neck = placed([ring(0.042, 0.006, ribbon)], z=0.12)
    return placed([*meshes, *part("ribbon", [*neck, *bow])], scale=1.25)


def sports_ball(rng: Random) -> Meshes:
    """In two colors."""
    first, second = pick(rng, _BRIGHT), pick(rng, ("#f5f2ea", "#1f2a44"))
    colors = np.stack([linear(hex_rgb(first)), linear(hex_rgb(second))])

    def color(points: np.ndarray, uv: np.ndarray) -> np.ndarray:
        angle = np.arctan2(points[:, 1], points[:, 0])
        band = (np.floor(angle / (np.pi / 3)) % 2).astype(np.int64)
        cap = np.abs(points[:, 2] - 0.085) > 0.076
        return np.asarray(np.where(cap[:, None], colors[1], colors[band]), np.float32)

    return [ball((0.085, 0.085, 0.085), Material(color, 0.05, 40), (0, 0, 0.085))]


def block(rng: Random) -> Meshes:
    """A wooden cube with a letter on each side."""
    letter = "ABCDEFGHKLMNPRSTXZ"[int(rng.integers(18))]
    ground = pick(rng, _BRIGHT)
    return board((0.05, 0.05, 0.05), painted(worded, (80, 80), ground, ((letter, 0.62, 0.5),), "#fff8e6", gloss=0.04))


def car(rng: Random) -> Meshes:
    """A toy car along x: body, cabin, four wheels."""
    paint, glass, black = plain(pick(rng, _BRIGHT), 0.08, 60), plain("#9fc4d8", 0.1, 90), plain("#1a1a1c")
    body = [ball((0.085, 0.04, 0.02), paint, (0, 0, 0.034), boxy=0.35)]
    cabin = [
        ball((0.042, 0.034, 0.022), glass, (-0.008, 0, 0.064), boxy=0.5),
        ball((0.036, 0.035, 0.006), paint, (-0.008, 0, 0.084), boxy=0.4),
    ]
    wheel = lathe(
        [(0, 0.011), (0.012, 0.011), (0.019, 0.009), (0.02, 0.0), (0.019, -0.009), (0, -0.009)], black, sides=24
    )
    wheels = []
    for x in (-0.05, 0.05):
        for side in (-1, 1):
            wheels += placed(wheel, x, side * 0.04, tip=-side * np.pi / 2, z=0.02)
            wheels += placed(
                lathe([(0.008, 0.0115), (0, 0.0125)], plain("#d9dadb", 0.08)),
                x,
                side * 0.04,
                tip=-side * np.pi / 2,
                z=0.02,
            )
    return [*body, *part("cabin", cabin), *part("wheels", wheels)]


def rings(rng: Random) -> Meshes:
    """Rings of many colors on a stick: one toy."""
    wood = plain("#d9b98a", 0.04, 30)
    start = int(rng.integers(len(_BRIGHT)))
    meshes = [
        *lathe([(0, 0), (0.055, 0), (0.055, 0.012), (0, 0.012)], wood),
        tube([(0, 0, 0.01), (0, 0, 0.15)], 0.008, wood),
    ]
    for k in range(5):
        color = _BRIGHT[(start + k) % len(_BRIGHT)]
        meshes.append(ring(0.042 - 0.006 * k, 0.0125, plain(color, 0.06, 50), (0, 0, 0.025 + 0.0235 * k)))
    return [*meshes, ball((0.015, 0.015, 0.015), plain(_BRIGHT[(start + 5) % 7], 0.06, 50), (0, 0, 0.152))]


def duck(rng: Random) -> Meshes:
    """A rubber duck."""
    yellow, beak, black = plain("#f4cb2b", 0.06, 50), plain("#ec7a1c", 0.06, 50), plain("#161616", 0.1)
    body = [
        ball((0.055, 0.042, 0.036), yellow, (0, 0, 0.036)),
        ball((0.018, 0.02, 0.022), yellow, (-0.05, 0, 0.056), (0, 0.6, 0)),
    ]
    head = [ball((0.03, 0.03, 0.03), yellow, (0.028, 0, 0.088))]
    eyes = [ball((0.004, 0.004, 0.005), black, (0.05, side * 0.016, 0.096)) for side in (-1, 1)]
    return [*body, *head, *eyes, *part("beak", [ball((0.016, 0.016, 0.006), beak, (0.06, 0, 0.083))])]


def robot(rng: Random) -> Meshes:
    """A tin robot: head, trunk, limbs."""
    tin, trim = plain(pick(rng, ("#8fa3b0", "#b0a38f", "#7f9a8a")), 0.08, 40), plain(pick(rng, _BRIGHT), 0.07, 40)
    eye = plain("#f7e9a0", 0.1, 60)
    head = [
        *box((0.05, 0.045, 0.04), tin, (0, 0, 0.175)),
        *(ball((0.007, 0.004, 0.007), eye, (x, -0.024, 0.18)) for x in (-0.012, 0.012)),
    ]
    head.append(tube([(0, 0, 0.195), (0, 0, 0.215)], 0.002, trim))
    trunk = [*box((0.075, 0.05, 0.085), tin, (0, 0, 0.11)), *box((0.045, 0.004, 0.04), trim, (0, -0.026, 0.115))]
    limbs = [mesh for x in (-0.022, 0.022) for mesh in box((0.026, 0.045, 0.068), trim, (x, -0.003, 0.034))]
    limbs += [
        tube([(side * 0.042, 0, 0.14), (side * 0.06, -0.012, 0.1), (side * 0.055, -0.03, 0.075)], 0.008, trim)
        for side in (-1, 1)
    ]
    return [*part("head", head), *trunk, *part("limbs", limbs)]


def donut(rng: Random) -> Meshes:
    """Iced, with a hole."""
    dough, icing = (
        mottled(("#9c5a22", "#cf9148", "#b57434"), 90, 1.0),
        plain(pick(rng, ("#3a1d10", "#e79bb4", "#f2e6d0")), 0.08, 40),
    )
    return [ring(0.036, 0.021, dough, (0, 0, 0.02)), ring(0.036, 0.0195, icing, (0, 0, 0.025))]


def carton(rng: Random) -> Meshes:
    """A packet of a shop with its name on all sides."""
    name = ("TEA", "OATS", "RICE", "SOAP", "SALT", "COCOA")[int(rng.integers(6))]
    ground = pick(rng, GLAZES)
    ink = "#fdf8ea" if ground not in ("#e8e2d4", "#e0b23c") else "#2b2320"
    paper = worded((200, 140), ground, ((name, 0.16, 0.25), ("fine", 0.08, 0.5), ("500 g", 0.09, 0.85)), ink)
    return board((0.09, 0.055, 0.14), painted(lambda: paper, gloss=0.05, polish=30))


def basket(rng: Random) -> Meshes:
    """Woven, hollow, with a handle."""
    cane = mottled(("#6b4a26", "#b08a52", "#8a6638"), 160, 1.6, stretch=(1, 1, 3))
    walls = lathe([(0, 0), (0.11, 0), (0.14, 0.1), (0.147, 0.103), (0.14, 0.106)], cane, sides=44)
    inside = lathe([(0.135, 0.1), (0.106, 0.006), (0, 0.006)], cane, sides=44)
    angle = np.linspace(0, np.pi, 26)
    arch = np.stack([0.142 * np.cos(angle), 0 * angle, 0.1 + 0.13 * np.sin(angle)], axis=1)
    return [*walls, *inside, *part("handle", [tube(arch, 0.007, cane)])]


def skipping_rope(rng: Random) -> Meshes:
    """Thin, lying in curves, with two grips."""
    control = rng.uniform(-0.13, 0.13, (7, 2)) * (1.0, 0.6)
    path = curve(np.concatenate([control, np.full((7, 1), 0.005)], axis=1), 70)
    grip = plain(pick(rng, _BRIGHT), 0.06, 40)
    ends = []
    for k, before in ((0, 2), (-1, -3)):
        way = (path[k] - path[before]) / np.linalg.norm(path[k] - path[before])
        ends.append(tube([path[k] + (0, 0, 0.007), path[k] + 0.1 * way + (0, 0, 0.007)], 0.012, grip))
    return [tube(path, 0.0042, plain("#e8dfc8"), sides=8), *part("grips", ends)]
