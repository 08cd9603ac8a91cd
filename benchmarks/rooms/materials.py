"""What drawn surfaces are made of: a color for each point, and how it shines.

Grain is three-dimensional noise and pictures are painted once each (`demo.sample_paint`), so that no texture repeats.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from demo.sample_paint import hex_rgb, ramp

F32 = NDArray[np.float32]

_SIDE = 64
"""Of the volume of noise, which repeats."""
_STEPS = 6
"""Of the volume, a feature of the noise."""


@dataclass(frozen=True, eq=False)
class Material:
    """How a surface looks.

    Attributes:
        color: linear RGB, float32 [N, 3], 0..1, of points [N, 3] of the object and their uv [N, 2].
        gloss: share of the light that is mirrored, 0..1.
        polish: exponent of its highlight.
        metal: whether all of its light is mirrored, in its color.
    """

    color: Callable[[F32, F32], F32]
    gloss: float = 0.03
    polish: float = 20.0
    metal: bool = False


def linear(rgb: F32) -> F32:
    """Linear light of sRGB values, both 0..1."""
    return np.where(rgb <= 0.04045, rgb / 12.92, ((np.maximum(rgb, 0) + 0.055) / 1.055) ** 2.4).astype(np.float32)


def plain(color: str, gloss: float = 0.03, polish: float = 20.0, *, metal: bool = False) -> Material:
    """One color, with the faint unevenness of everything."""
    return mottled((color, color), 30, 0.0, gloss, polish, metal=metal, uneven=0.06)


def mottled(
    colors: Sequence[str],
    scale: float,
    contrast: float = 1.0,
    gloss: float = 0.03,
    polish: float = 20.0,
    *,
    stretch: Sequence[float] = (1, 1, 1),
    metal: bool = False,
    uneven: float = 0.0,
) -> Material:
    """Colors mixed by three-dimensional noise; `scale` = features a meter, fewer along axes of a small `stretch`."""
    table = linear(ramp(np.linspace(0, 1, 256, dtype=np.float32), colors))
    step = (scale * _STEPS * np.asarray(stretch)).astype(np.float32)

    def color(points: F32, uv: F32) -> F32:
        field = _field(points * step)
        rgb = table[np.clip(255 * (0.5 + contrast * (field - 0.5)), 0, 255).astype(np.int64)]
        return np.asarray(rgb * (1 + uneven * 2 * (field - 0.5))[:, None], np.float32) if uneven else rgb

    return Material(color, gloss, polish, metal)


def painted(paint: Callable[..., F32], *words: Any, gloss: float = 0.03, polish: float = 20.0) -> Material:
    """A picture laid once over the uv square: `paint(*words)`, sRGB float32 [H, W, 3], row 0 on top. It is painted when
    it is first seen."""
    stored = cache(lambda: linear(np.clip(paint(*words), 0, 1)))

    def color(points: F32, uv: F32) -> F32:
        picture = stored()
        height, width = picture.shape[:2]
        x = np.clip(uv[:, 0], 0, 1) * (width - 1)
        y = (1 - np.clip(uv[:, 1], 0, 1)) * (height - 1)
        left, top = np.minimum(x.astype(np.int64), width - 2), np.minimum(y.astype(np.int64), height - 2)
        a, b = (x - left)[:, None], (y - top)[:, None]
        above = (1 - a) * picture[top, left] + a * picture[top, left + 1]
        below = (1 - a) * picture[top + 1, left] + a * picture[top + 1, left + 1]
        return np.asarray((1 - b) * above + b * below, np.float32)

    return Material(color, gloss, polish)


def worded(size: tuple[int, int], ground: str, words: Sequence[tuple[str, float, float]], ink: str = "#222222") -> F32:
    """A picture [H, W, 3] of words on a ground: each word with the height of its letters and its line's middle, as
    shares of the picture's height."""
    height, width = size
    picture = np.empty((height, width, 3), np.uint8)
    picture[:] = np.round(255 * hex_rgb(ground))
    color = tuple((255 * hex_rgb(ink)).tolist())
    for word, tall, line in words:
        scale = tall * height / 22
        thick = max(1, round(2 * scale))
        (wide, high), _ = cv2.getTextSize(word, cv2.FONT_HERSHEY_DUPLEX, scale, thick)
        corner = (int((width - wide) / 2), int(line * height + high / 2))
        cv2.putText(picture, word, corner, cv2.FONT_HERSHEY_DUPLEX, scale, color, thick, cv2.LINE_AA)
    return picture.astype(np.float32) / np.float32(255)


@cache
def _volume() -> F32:
    """Noise with a power-law spectrum, float32 [side + 1] * 3, mean 0.5, about 0..1; its ends are alike."""
    rng = np.random.default_rng(1)
    spectrum = np.fft.rfftn(rng.standard_normal((_SIDE,) * 3))
    whole, half = np.fft.fftfreq(_SIDE), np.fft.rfftfreq(_SIDE)
    frequency = np.sqrt(whole[:, None, None] ** 2 + whole[None, :, None] ** 2 + half[None, None, :] ** 2)
    frequency[0, 0, 0] = np.inf
    field = np.fft.irfftn(spectrum / np.maximum(frequency, 1 / (2 * _STEPS)) ** 2.1, s=(_SIDE,) * 3, axes=(0, 1, 2))
    field = np.clip(0.5 + 0.22 * (field - field.mean()) / field.std(), 0, 1)
    return np.pad(field, (0, 1), mode="wrap").astype(np.float32)


def _field(points: F32) -> F32:
    """float32 [N]: the noise at points [N, 3] in steps of the volume, interpolated."""
    volume = _volume()
    lower = np.floor(points)
    share = points - lower
    i, j, k = (lower.astype(np.int64) % _SIDE).T
    a, b, c = share.T
    value = np.zeros(len(points), np.float32)
    for corner in range(8):
        di, dj, dk = corner & 1, corner >> 1 & 1, corner >> 2
        weight = (a if di else 1 - a) * (b if dj else 1 - b) * (c if dk else 1 - c)
        value += weight * volume[i + di, j + dj, k + dk]
    return value
