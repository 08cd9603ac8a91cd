"""Radial lens distortion with two parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class RadialLens:
    """Lens model of COLMAP's SIMPLE_RADIAL.

    (x, y) at depth 1 is projected f·(1 + k₁ r²)·(x, y) off the image center, r² = x² + y².
    """

    focal: float  # f over the longer side of the image as captured
    k1: float  # k₁, dimensionless


def middle_lens(lenses: Sequence[RadialLens]) -> RadialLens | None:
    """Returns the lens with the (lower) median focal length; None if there are none."""
    if not lenses:
        return None
    return sorted(lenses, key=lambda lens: (lens.focal, lens.k1))[(len(lenses) - 1) // 2]
