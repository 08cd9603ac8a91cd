"""Pictures painted by numpy for the sample scene and for drawn rooms: wall, cloth, prints, covers. None is ever tiled.

Every function takes a size in pixels and a seed, and returns float32 [H, W, 3], sRGB in 0..1, row 0 on top.
Structure from motion needs features that exist once in the scene: all fields are multi-octave noise, all motifs
differ in shape, colour, size and grain.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

_EARTH = ("#e9dcc3", "#d9b48f", "#c98a67", "#8fa08a", "#5f7f86", "#dcc9a4", "#e8e0cf", "#a9b99a")
_LEAVES = ("#4f6f52", "#86a789", "#c7684a", "#e0a458", "#34566b", "#8a4f4a", "#b9c6a2", "#d98e73", "#5b8a99", "#6b5a3a")


def hex_rgb(colour: str) -> Array:
    """'#rrggbb' to sRGB float32 [3] in 0..1."""
    return np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)], np.float32)


def noise(height: int, width: int, slope: float, seed: int) -> Array:
    """Noise with a power-law spectrum (amplitude ~ 1/f^slope), float32 [H, W], mean 0.5, about 0..1."""
    rng = np.random.default_rng(seed)
    spectrum = np.fft.rfft2(rng.standard_normal((height, width)))
    fy, fx = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :]
    frequency = np.hypot(fy, fx)
    frequency[0, 0] = np.inf
    field = np.fft.irfft2(spectrum / frequency**slope, s=(height, width))
    return np.asarray(np.clip(0.5 + 0.22 * (field - field.mean()) / field.std(), 0, 1), np.float32)


def ramp(field: Array, colours: Sequence[str]) -> Array:
    """A field in 0..1 through evenly spaced colours, float32 [H, W, 3]."""
    stops = np.linspace(0, 1, len(colours))
    table = np.stack([hex_rgb(c) for c in colours])
    return np.stack([np.interp(field, stops, table[:, k]) for k in range(3)], axis=-1).astype(np.float32)


def mural(height: int, width: int, seed: int) -> Array:
    """Washed, terraced colours with a painter's grain: the walls."""
    field = _warp(noise(height, width, 1.9, seed), seed + 1, 0.06)
    rings = field * 11
    terraces = (np.floor(rings) + np.clip((rings % 1 - 0.5) * 14 + 0.5, 0, 1)) / 11
    picture = ramp(np.clip(terraces, 0, 1), _EARTH)
    picture = 0.5 * picture + 0.5 * hex_rgb("#efe8da")
    _scatter(picture, 110, (height / 40, height / 14), seed + 2, strength=0.4)
    return _grain(picture, seed + 3, 0.16)


def cloth(height: int, width: int, seed: int) -> Array:
    """Linen printed with leaves and dots of many kinds, no two alike."""
    picture = ramp(noise(height, width, 1.0, seed), ("#e4d9c2", "#f3ecdd", "#efe4cd"))
    _scatter(picture, 330, (height / 40, height / 11), seed + 1, strength=0.92)
    down, right = np.arange(height)[:, None], np.arange(width)[None]
    edge = np.minimum(np.minimum(down, height - 1 - down), np.minimum(right, width - 1 - right))
    border = (edge > height * 0.02) & (edge < height * 0.035)
    picture[border] = 0.25 * picture[border] + 0.75 * hex_rgb("#34566b")
    return _grain(picture, seed + 2, 0.14)


def planks(height: int, width: int, seed: int) -> Array:
    """Wooden boards, each with its own tone and grain: the floor."""
    rng = np.random.default_rng(seed)
    picture = np.empty((height, width, 3), np.float32)
    row = 0
    while row < height:
        deep = int(rng.integers(height // 22, height // 15))
        column = -int(rng.integers(0, width // 5))
        while column < width:
            long = int(rng.integers(width // 5, width // 2))
            top, left, right = row, max(column, 0), min(column + long, width)
            rows = min(deep, height - top)
            field = noise(deep * 4, max(long // 12, 8), 1.2, int(rng.integers(1 << 31)))
            stretched = field[np.linspace(0, deep * 4 - 1, deep).astype(int)][
                :, np.linspace(0, field.shape[1] - 1, long).astype(int)
            ]
            tone = float(rng.uniform(-0.18, 0.18))
            piece = ramp(np.clip(stretched + tone, 0, 1), ("#4a3424", "#7c5a3c", "#a67c52", "#8a6543"))
            piece[:2], piece[:, :2] = piece[:2] * 0.4, piece[:, :2] * 0.4
            picture[top : top + rows, left:right] = piece[:rows, left - column : left - column + right - left]
            column += long
        row += deep
    return _grain(picture, seed + 1, 0.12)


def print_landscape(height: int, width: int, seed: int) -> Array:
    """A framed print: sun and hill lines."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    picture = ramp(y / height, ("#f3d9b1", "#eeb27d", "#d98e73"))
    sun = np.hypot(x - 0.66 * width, y - 0.3 * height) < 0.13 * width
    picture[sun] = hex_rgb("#c8452f")
    for k, colour in enumerate(("#b9c6a2", "#86a789", "#5b8a99", "#34566b", "#22333f")):
        line = noise(4, width, 1.6, seed + 7 * k)[1]
        hill = y > height * (0.42 + 0.11 * k + 0.26 * (line - 0.5))[None, :]
        shade = 0.85 + 0.3 * noise(height, width, 1.1, seed + 50 + k)
        picture[hill] = (hex_rgb(colour) * shade[..., None])[hill]
    return _grain(_mat(picture), seed + 1, 0.08)


def print_shapes(height: int, width: int, seed: int) -> Array:
    """A framed print: cut-out shapes."""
    picture = np.broadcast_to(hex_rgb("#f1e8d8"), (height, width, 3)).astype(np.float32)
    _scatter(picture, 26, (height / 8, height / 2.6), seed, strength=0.95)
    return _grain(_mat(picture), seed + 1, 0.08)


def cover(height: int, width: int, seed: int, colours: Sequence[str]) -> Array:
    """A book cover: warped bands in the given colours under a few leaves."""
    field = _warp(noise(height, width, 1.7, seed), seed + 1, 0.1)
    picture = ramp(np.floor(field * np.float32(9)) / np.float32(9), colours)
    _scatter(picture, 14, (height / 10, height / 4), seed + 2, strength=0.8)
    return _grain(picture, seed + 3, 0.08)


def bottle_label(height: int, width: int, seed: int) -> Array:
    """A paper label: a painted hill, a seal and lines of small writing."""
    rng = np.random.default_rng(seed)
    picture = np.broadcast_to(hex_rgb("#f2e7cf"), (height, width, 3)).astype(np.float32)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    for k, colour in enumerate(("#d98e73", "#8a4f4a", "#4f6f52")):
        line = noise(4, width, 1.5, seed + k)[1]
        hill = (y > height * (0.16 + 0.1 * k + 0.2 * (line - 0.5))[None, :]) & (y < height * 0.52)
        picture[hill] = hex_rgb(colour)
    picture[np.hypot(x - 0.5 * width, y - 0.2 * height) < 0.1 * height] = hex_rgb("#c8452f")
    for k, size in enumerate((0.1, 0.045, 0.045, 0.035)):
        top = 0.58 + (0, 0.15, 0.22, 0.3)[k]
        column = 0.36 * width
        while column < 0.64 * width:
            letter = int(rng.integers(3, 8) * (2 if k == 0 else 1))
            rows = slice(int(top * height), int((top + size) * height))
            picture[rows, int(column) : int(column) + letter] = hex_rgb("#2b2320")
            column += letter + rng.integers(3, 7)
    picture[(y < 0.03 * height) | (y > 0.97 * height)] = hex_rgb("#a9792f")
    return picture


def _mat(picture: Array) -> Array:
    h, w = picture.shape[:2]
    b = int(0.07 * min(h, w))
    framed = np.full((h, w, 3), 0.93, np.float32)
    framed[b:-b, b:-b] = picture[b:-b, b:-b]
    return framed


def _grain(picture: Array, seed: int, amount: float) -> Array:
    h, w = picture.shape[:2]
    field = 0.6 * noise(h, w, 0.9, seed) + 0.4 * noise(h, w, 0.45, seed + 1)
    return np.asarray(np.clip(picture * (1 + 2 * amount * (field - 0.5))[..., None], 0, 1), np.float32)


def _warp(field: Array, seed: int, amount: float) -> Array:
    h, w = field.shape
    dy = (noise(h, w, 1.8, seed) - 0.5) * amount * 4 * h
    dx = (noise(h, w, 1.8, seed + 1) - 0.5) * amount * 4 * h
    y, x = np.mgrid[0:h, 0:w]
    return np.asarray(field[np.clip(y + dy, 0, h - 1).astype(int), np.clip(x + dx, 0, w - 1).astype(int)])


def _scatter(picture: Array, count: int, size: tuple[float, float], seed: int, strength: float) -> None:
    """Paints leaves, dots, rings and petals at random places into `picture`, in place."""
    rng = np.random.default_rng(seed)
    h, w = picture.shape[:2]
    for _ in range(count):
        radius = float(np.exp(rng.uniform(*np.log(size))))
        cy, cx, turn = rng.uniform(0, h), rng.uniform(0, w), rng.uniform(0, 2 * np.pi)
        top, left = max(int(cy - radius), 0), max(int(cx - radius), 0)
        y, x = np.mgrid[top : min(int(cy + radius), h), left : min(int(cx + radius), w)].astype(np.float32)
        if y.size == 0:
            continue
        y, x = (y - cy) / radius, (x - cx) / radius
        a, b = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        r, angle = np.hypot(a, b), np.arctan2(b, a)
        kind = rng.integers(5)
        if kind <= 1:  # a leaf with veins
            slim, veins = rng.uniform(0.22, 0.5), rng.uniform(6, 13)
            b = b - rng.uniform(-0.3, 0.3) * (a**2 - 0.5)
            shape = np.abs(b) < slim * (1 - a**2) * (1 + rng.uniform(-0.4, 0.4) * a)
            detail = (np.abs(b) < 0.03) | (np.sin(veins * (a - np.abs(b) * rng.uniform(0.6, 1.6))) > 0.9)
        elif kind == 2:  # a blossom
            petals = rng.integers(4, 9)
            shape = r < 0.62 + 0.34 * np.cos(petals * angle + rng.uniform(0, 6))
            detail = r < rng.uniform(0.12, 0.3)
        elif kind == 3:  # a pebble with a ring
            shape = r < 0.7 + rng.uniform(0.05, 0.2) * np.sin(2 * angle) + rng.uniform(0, 0.1) * np.sin(5 * angle)
            detail = np.abs(r - rng.uniform(0.3, 0.5)) < 0.06
        else:  # a twig with berries
            curve = rng.uniform(-0.5, 0.5) * (a**2 - 0.4)
            shape = (np.abs(b - curve) < 0.05) & (np.abs(a) < 0.9)
            for _ in range(int(rng.integers(4, 9))):
                shape |= np.hypot(a - rng.uniform(-0.8, 0.8), b - rng.uniform(-0.45, 0.45)) < rng.uniform(0.08, 0.2)
            detail = np.zeros_like(shape)
        first, second = rng.choice(len(_LEAVES), 2, replace=False)
        tone = hex_rgb(_LEAVES[first]) * rng.uniform(0.8, 1.2)
        colour = np.where(detail[..., None], hex_rgb(_LEAVES[second]), tone + 0.12 * (a + b)[..., None])
        part = picture[top : top + y.shape[0], left : left + y.shape[1]]
        part[shape] = (1 - strength) * part[shape] + strength * np.clip(colour, 0, 1)[shape]
