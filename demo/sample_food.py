"""Fruit and doughnuts for the sample scene, in meters; each stands on z = 0 and faces -y."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from demo.sample_mesh import Parts, ball, grid, lathe, mottled, plain, spline, tube


def apple(colours: tuple[str, ...], seed: int) -> Parts:
    """An apple: a flush of streaks over its ground colour."""
    skin = mottled(
        f"apple skin {seed}",
        colours,
        42,
        0.25,
        0,
        (1, 1, 0.2),
        0.75,
        coat_weight=0.3,
    )
    profile = [
        (0, 0.007),
        (0.007, 0.002),
        (0.015, 0.001),
        (0.0265, 0.012),
        (0.0365, 0.036),
        (0.0385, 0.052),
        (0.0315, 0.068),
        (0.019, 0.0735),
        (0.007, 0.067),
        (0, 0.058),
    ]
    body = lathe("apple", profile, skin, 64, 60)
    stem = tube(
        "stem",
        spline([(0, 0, 0.058), (0.001, 0, 0.074), (0.007, 0.002, 0.092)], 12),
        0.0017,
        plain(f"stem {seed}", "#4a3320", 0.8),
        10,
    )
    return [body, stem]


def orange(seed: int) -> Parts:
    """An orange with pored peel and its stalk's star."""
    peel = mottled(f"peel {seed}", ("#e8780f", "#f39a1f", "#ee8712"), 60 + seed, 0.38, 0.0012, subsurface_weight=0.0)
    fruit = ball("orange", (0.037, 0.0365, 0.0345), peel, (0, 0, 0.034))
    star = lathe("stalk", [(0.0035, 0.0676), (0.003, 0.0694), (0, 0.0692)], plain(f"stalk {seed}", "#6f7a3a", 0.8), 7)
    return [fruit, star]


def banana() -> Parts:
    """A hand of three bananas."""
    peel = mottled("banana peel", ("#c99a1c", "#f2cd34", "#f6d84a", "#eec42c", "#8a6a20"), 34, 0.45, 0, (1, 1, 1), 0.8)
    tip = plain("banana tip", "#4a3b1e", 0.8)
    parts: Parts = []
    for k, (swing, lift) in enumerate(((-0.24, 0.0), (0.08, 0.004), (0.4, 0.012))):
        arc = np.linspace(0, 1, 40)
        bend = 1.75 * (arc - 0.5)
        path = np.stack(
            [0.105 * np.sin(bend), 0.105 * (np.cos(bend) - 1) + 0.03, 0.0175 + lift + 0.012 * (2 * arc - 1) ** 2],
            axis=1,
        )
        radius = 0.0165 * np.clip(np.minimum(np.minimum(0.36 + 4.0 * arc, 1), 0.3 + 5.5 * (1 - arc)), 0, 1)
        centre, angle = path[0].copy(), swing
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        path = (path - centre) @ turn.T + centre
        parts.append(tube(f"banana {k}", path, radius, peel, 7))
        parts[-1].modifiers.new("round", "SUBSURF").render_levels = 2
        parts.append(tube(f"tip {k}", path[-2:] + (path[-1] - path[-3]) * np.array([[0.3], [0.9]]), 0.0048, tip, 12))
    stalk = spline([path[0] + (0.006, 0, 0), path[0] - (0.014, 0.012, -0.004), path[0] - (0.026, 0.028, -0.008)], 10)
    parts.append(
        tube("stalk", stalk, np.linspace(0.011, 0.007, 10), mottled("stalk", ("#a8922c", "#6b5424"), 60, 0.7), 12)
    )
    return parts


def donut(glaze: tuple[str, str], seed: int) -> Parts:
    """An iced ring doughnut with sprinkles."""
    rng = np.random.default_rng(seed)
    dough = mottled(f"dough {seed}", ("#9c5a22", "#cf9148", "#b57434"), 45, 0.75, 0.001)
    icing = mottled(f"icing {seed}", glaze, 30, 0.25, coat_weight=0.4)
    around, across = np.linspace(0, 2 * pi, 72, endpoint=False)[:, None], np.linspace(0, 2 * pi, 40, endpoint=False)

    def ring(radius: float, a: Any) -> Any:
        r = 0.038 + radius * np.cos(a)
        return np.stack(
            [r * np.cos(around), r * np.sin(around), 0.021 + 0.82 * radius * np.sin(a) + 0 * around], axis=-1
        )

    parts = [grid("dough", ring(0.0225, across + 0 * around), dough, wrap=True, close=True)]
    wave = 0.22 * np.sin(5 * around + 1) + 0.16 * np.sin(9 * around) + 0.1 * np.sin(14 * around + 2)
    top = np.linspace(0, 1, 30)
    parts.append(
        grid("icing", ring(0.0242, -0.12 - wave * (1 - top) + top * (pi + 0.3) + 0 * around), icing, close=True)
    )
    colours = [
        plain(f"sprinkle {seed} {c}", c, 0.3)
        for c in ("#f7f3e8", "#f2c230", "#3f9bc0", "#6bb04a", "#c8322f", "#7a4aa0")
    ]
    for _ in range(70):
        theta, a, spin = rng.uniform(0, 2 * pi), rng.uniform(0.45, pi - 0.45), rng.uniform(0, pi)
        r = 0.038 + 0.0245 * np.cos(a)
        at = np.array([r * np.cos(theta), r * np.sin(theta), 0.021 + 0.0202 * np.sin(a)])
        step = 0.0028 * np.array([np.cos(spin), np.sin(spin), 0])
        parts.append(tube("sprinkle", [at - step, at, at + step], 0.0009, colours[int(rng.integers(6))], 8))
    return parts
