"""Answers as pictures."""

from __future__ import annotations

from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from service.common.errors import InvalidInputError

U8 = NDArray[np.uint8]

# Polynomial approximation of the Turbo colour map: A. Mikhailov, "Turbo, An Improved Rainbow Colormap for
# Visualization", Google AI Blog 2019; coefficients by R. Du (Apache-2.0). Columns r g b, rows x⁰..x⁵.
_TURBO = np.array(
    [
        [0.13572138, 0.09140261, 0.10667330],
        [4.61539260, 2.19418839, 12.64194608],
        [-42.66032258, 4.84296658, -60.58204836],
        [132.13108234, -14.18503333, 110.36276771],
        [-152.94239396, 4.27729857, -89.90310912],
        [59.28637943, 2.82956604, 27.34824973],
    ]
)
_OUTLINE = np.array([255, 255, 255], dtype=np.uint8)


def turbo(values: NDArray[np.floating]) -> U8:
    """uint8 [..., 3] of values [...] in 0..1 (clamped; NaN counts as 0): blue is low, red is high."""
    x = np.clip(np.nan_to_num(np.asarray(values, dtype=np.float64), nan=0.0), 0.0, 1.0)[..., None]
    colour = np.zeros((*x.shape[:-1], 3))
    for row in _TURBO[::-1]:
        colour = colour * x + row
    return np.asarray((np.clip(colour, 0.0, 1.0) * 255.0).round(), dtype=np.uint8)


def overlay(
    rgb: U8, mask: NDArray[np.bool_], *, colour: tuple[int, int, int] = (255, 64, 32), strength: float = 0.5
) -> U8:
    """uint8 [H, W, 3]: `rgb` with the mask's pixels tinted and its inner edge drawn in white.

    Raises:
        InvalidInputError: `rgb` and `mask` are not of one size.
    """
    if rgb.shape != (*mask.shape, 3):
        raise InvalidInputError(f"a mask of shape {mask.shape} on an image of shape {rgb.shape}", field="mask")
    picture = rgb.copy()
    tinted = rgb[mask] * (1.0 - strength) + np.array(colour) * strength
    picture[mask] = tinted.round().astype(np.uint8)
    picture[mask & ~_eroded(mask)] = _OUTLINE
    return picture


def relevancy_picture(rgb: U8, relevancy: NDArray[np.float32], *, strength: float = 0.7) -> U8:
    """uint8 [H, W, 3]: the relevancy [H, W] in Turbo over the grey image, on the scale 0..1, never stretched."""
    grey = rgb @ np.array([0.299, 0.587, 0.114])
    mixed = turbo(relevancy) * strength + grey[..., None] * (1.0 - strength)
    return np.asarray(mixed.round().clip(0, 255), dtype=np.uint8)


def png_bytes(image: U8) -> bytes:
    """A PNG of uint8 [H, W, 3] (RGB) or [H, W] (grey).

    Raises:
        InvalidInputError: another shape or dtype.
    """
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise InvalidInputError(f"an image of shape {image.shape} and type {image.dtype}", field="image")
    file = BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(file, format="PNG")
    return file.getvalue()


def _eroded(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mask without its pixels that touch background or the image's border by an edge."""
    inner = np.zeros_like(mask)
    inner[1:-1, 1:-1] = mask[1:-1, 1:-1] & mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
    return inner
