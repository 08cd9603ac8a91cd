"""The potted plant, and the vase with its tulips, for the sample scene, in meters; each stands on z = 0."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from demo.sample_mesh import Parts, grid, lathe, mottled, plain, spline, tube


def plant() -> Parts:
    """A rubber plant in a terracotta pot."""
    rng = np.random.default_rng(5)
    clay = mottled("terracotta", ("#b5532f", "#d0683c", "#c25c35", "#dc8458"), 22, 0.8, 0.0006)
    pot = lathe(
        "pot",
        [
            (0, 0),
            (0.045, 0),
            (0.048, 0.004),
            (0.062, 0.085),
            (0.069, 0.086),
            (0.07, 0.108),
            (0.063, 0.11),
            (0.06, 0.09),
            (0, 0.09),
        ],
        clay,
    )
    soil = lathe(
        "soil",
        [(0.061, 0.094), (0.03, 0.1), (0, 0.101)],
        mottled("soil", ("#2a1d14", "#4a3524", "#241910"), 160, 0.95, 0.004),
    )
    green = [
        mottled(f"leaf {k}", tones, 30, 0.35, 0.0, (1, 1, 1), coat_weight=0.2)
        for k, tones in enumerate(
            (("#2f6a35", "#4a8f46"), ("#3b7d3c", "#6bab52"), ("#28603a", "#438648"), ("#5a9c44", "#98c868"))
        )
    ]
    bark = plain("bark", "#5c6b39", 0.8)
    parts: Parts = [pot, soil]
    count = 64
    for k in range(count):
        turn, high = k * 2.399963, k / (count - 1)  # the golden angle spreads leaves evenly
        length = rng.uniform(0.06, 0.1) * (1.1 - 0.3 * high)
        rise = 0.1 + 1.05 * high + rng.uniform(-0.2, 0.2)
        foot = np.array([0.014 * np.cos(turn), 0.014 * np.sin(turn), 0.1])
        out = np.array([np.cos(turn), np.sin(turn), 0.0])
        knee = (
            foot
            + out * (0.05 * (1.2 - high) * rng.uniform(0.6, 1.2))
            + (0, 0, 0.03 + 0.13 * high + rng.uniform(-0.012, 0.012))
        )
        parts.append(tube(f"stem {k}", spline([foot, 0.5 * (foot + knee) + (0, 0, 0.015), knee], 10), 0.0016, bark, 8))
        parts.append(
            _leaf(f"leaf {k}", knee, out, rise, length, rng.uniform(0.24, 0.32) * length, green[int(rng.integers(4))])
        )
    return parts


def vase() -> Parts:
    """A painted vase."""
    glaze = mottled(
        "vase glaze",
        ("#f1e9da", "#e4d3b4", "#3f6f8f", "#f4eee2", "#254f70"),
        26,
        0.25,
        0,
        (1, 1, 0.6),
        0.9,
        coat_weight=0.5,
    )
    profile = [
        (0, 0),
        (0.03, 0),
        (0.036, 0.01),
        (0.054, 0.06),
        (0.05, 0.105),
        (0.028, 0.145),
        (0.022, 0.165),
        (0.03, 0.185),
        (0.027, 0.184),
        (0.018, 0.165),
        (0.02, 0.14),
    ]
    return [lathe("vase", profile, glaze, 80, 120)]


def tulips() -> Parts:
    """Five tulips, cut to stand in the vase."""
    rng = np.random.default_rng(12)
    green = mottled("tulip green", ("#3f7a3c", "#74a85a"), 40, 0.5)
    parts: Parts = []
    for k, colour in enumerate(("#8a4aa0", "#f3efe6", "#c25a9a", "#f0d060", "#6a3f96")):
        turn, lean = 2 * pi * k / 5 + 0.3, rng.uniform(0.035, 0.07)
        out = np.array([np.cos(turn), np.sin(turn), 0.0])
        top = out * lean + (0, 0, rng.uniform(0.26, 0.31))
        parts.append(
            tube("stem", spline([out * 0.004 + (0, 0, 0.12), out * 0.012 + (0, 0, 0.2), top], 16), 0.0026, green, 10)
        )
        petals = mottled(f"petal {k}", (colour, colour, "#f0d9a0"), 30, 0.5, 0, (1, 1, 0.5), 0.5)
        bloom = lathe(
            "bloom",
            [(0, -0.004), (0.014, 0.002), (0.0205, 0.018), (0.0185, 0.034), (0.013, 0.046), (0.009, 0.04), (0, 0.02)],
            petals,
            24,
            40,
        )
        for vertex in bloom.data.vertices:  # three petals, open at the top
            x, y, z = vertex.co
            open_up = 1 + 0.16 * np.cos(3 * np.arctan2(y, x)) * z / 0.046
            vertex.co = (0.85 * x * open_up, 0.85 * y * open_up, 1.15 * z * open_up**0.5)
        bloom.location, bloom.rotation_euler = top, (-0.5 * out[1], 0.5 * out[0], turn)
        parts.append(bloom)
        parts.append(
            _leaf(
                f"blade {k}",
                out * 0.014 + (0, 0, 0.17),
                np.array([np.cos(turn + 0.7), np.sin(turn + 0.7), 0.0]),
                1.0,
                0.1,
                0.017,
                green,
            )
        )
    return parts


def _leaf(name: str, foot: Any, out: Any, rise: float, length: float, half: float, material: Any) -> Any:
    along, across = np.linspace(0, 1, 18)[:, None], np.linspace(-1, 1, 9)
    pitch = rise - 1.5 * along  # it rises, then bows over
    step = length / 17
    forward = np.cumsum(np.cos(pitch) * step, axis=0)
    upward = np.cumsum(np.sin(pitch) * step, axis=0)
    width = half * np.sin(pi * np.clip(along, 0.02, 0.995) ** 0.8) ** 0.8
    side = np.array([-out[1], out[0], 0.0])
    sheet = np.asarray(foot) + (forward[..., None] * out) + (across * width)[..., None] * side
    sheet = sheet + np.stack([0 * across * along, 0 * across * along, upward + 0.25 * width * across**2], axis=-1)
    return grid(name, sheet, material)
