"""Color names by their centers in CIELAB, and the match of measured colors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

_CENTERS: Mapping[str, str] = {
    "red": "e50000 840000 ff474c bb3f3f",
    "orange": "f97306 c65102 fdaa48 d8863b",
    "yellow": "ffff14 d5b60a fffe7a eedc5b",
    "green": "15b01a 033500 96f97b 74a662 677a04",
    "blue": "0343df 00035b 95d0fc 49759c 01153e",
    "purple": "7e1e9c 35063e bf77f6 84597e",
    "pink": "ff81c0 cb416b ffd1df d5869d",
    "brown": "653700 341c02 ad8150 876e4b",
    "black": "000000 1d1d1d",
    "white": "ffffff f2f2f2",
    "gray": "929591 363737 b5b5b5 59656d",
    "beige": "e6daa6",
    "turquoise": "06c2ac 045c5a 7ef4cc",
    "violet": "9a0eea 7e1e9c bf77f6",
}
"""sRGB centers by name, dark, light and dull (xkcd survey, Munroe 2010, CC0).

Black and white have a second center and gray a darker light one: nothing in a photo is as black or white as a screen.
"""
_OVERLAPS: Mapping[str, tuple[str, ...]] = {
    "beige": ("brown", "white", "yellow"),
    "turquoise": ("green", "blue"),
    "violet": ("purple",),
}
"""Names beyond the eleven basic terms (Berlin and Kay 1969) and their overlaps."""
_SPELLINGS: Mapping[str, str] = {"grey": "gray", "teal": "turquoise"}

UNMEASURED = frozenset({"golden", "gold", "silver"})
"""Sheens, which a mean color does not show."""
SHADES: Mapping[str, str] = {"light": "light", "pale": "light", "dark": "dark"}
NAMES = frozenset({*_CENTERS, *_SPELLINGS, *UNMEASURED} - {"gold"})

_MARGIN = 5.0
"""CIE94 margin by which a color must be nearest to a name."""
_NOT_DENIED = 0.25
"""Clear share of an object from which its color is never denied."""
_FARTHEST = 30.0
_MOST_SPREAD = 25.0
_LIGHT, _DARK, _SHADE_MARGIN = 62.0, 42.0, 6.0
_KL = 2.0
_WHITE = np.array([0.95047, 1.0, 1.08883])
_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


def lab_of(rgb: F64) -> F64:
    """Converts sRGB [..., 3] in 0..1 (IEC 61966-2-1) to CIELAB (D65, 2°)."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((np.maximum(rgb, 0.04045) + 0.055) / 1.055) ** 2.4)
    ratio = linear @ _TO_XYZ.T / _WHITE
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    lightness = 116 * f[..., 1] - 16
    return np.stack([lightness, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


def color_distance(first: F64, second: F64) -> F64:
    """CIE94 (CIE 116-1995), symmetric by the chromas' geometric mean; lightness counts half.

    k_L = 2, because light and shadow change lightness more than an object's color does."""
    chroma_1, chroma_2 = np.hypot(first[..., 1], first[..., 2]), np.hypot(second[..., 1], second[..., 2])
    mean = np.sqrt(chroma_1 * chroma_2)
    chroma = chroma_1 - chroma_2
    hue = np.maximum(((first - second)[..., 1:] ** 2).sum(axis=-1) - chroma**2, 0.0)
    lightness = (first - second)[..., 0] / _KL
    return np.asarray(np.sqrt(lightness**2 + (chroma / (1 + 0.045 * mean)) ** 2 + hue / (1 + 0.015 * mean) ** 2))


def color_shares(lab: F64, weights: F64) -> Mapping[str, float]:
    """Share of an object, 0..1, clearly in each color, from CIELAB [N, 3] and weights."""
    distances = _distances(lab)
    total = max(float(weights.sum()), np.finfo(np.float64).tiny)
    return {name: float(weights[_nearer(distances, name) >= 1].sum()) / total for name in _LAB}


def color_clearness(lab: F64, spread: float, share: float, name: str, shade: str = "") -> tuple[float, float]:
    """CIE94 distance of a color from a name, and how clearly it has that name.

    Clearness: from 1 on yes, from -1 down no, undecided in between.

    Args:
        lab: float64 [3], CIELAB.
        spread: median CIE94 deviation of the object's colors; if large, nothing is decided.
        share: 0..1 of the object clearly of that name, see `color_shares`.
        name: of `NAMES`, but not of `UNMEASURED`.
        shade: "", "light" or "dark".
    """
    name = basic_name(name)
    distances = _distances(lab)
    distance, clearness = float(distances[name]), float(_nearer(distances, name))
    if distance > _FARTHEST:
        clearness = min(clearness, 0.0)
    if shade and clearness > 0:
        lighter = (lab[0] - _LIGHT) if shade == "light" else (_DARK - lab[0])
        clearness = min(clearness, float(lighter) / _SHADE_MARGIN + 1.0)
    if spread > _MOST_SPREAD:
        clearness = float(np.clip(clearness, -0.99, 0.99))
    if share >= _NOT_DENIED:
        clearness = max(clearness, -0.99)
    return distance, clearness


def basic_name(name: str) -> str:
    """Normalizes the spelling of a name of `NAMES`: "grey" is gray."""
    return _SPELLINGS.get(name, name)


def _distances(lab: F64) -> Mapping[str, F64]:
    """CIE94 of CIELAB [..., 3] to the nearest center of each name."""
    return {name: color_distance(lab[..., None, :], centers).min(axis=-1) for name, centers in _LAB.items()}


def _nearer(distances: Mapping[str, F64], name: str) -> F64:
    """Margins by which a color is nearer to a name than to non-overlapping names."""
    rivals = [
        distance
        for rival, distance in distances.items()
        if rival != name and rival not in _OVERLAPS and rival not in _OVERLAPS.get(name, ())
    ]
    return np.asarray((np.min(rivals, axis=0) - distances[name]) / _MARGIN)


_LAB: Mapping[str, F64] = {
    name: lab_of(np.array([list(bytes.fromhex(center)) for center in centers.split()], dtype=np.float64) / 255)
    for name, centers in _CENTERS.items()
}
