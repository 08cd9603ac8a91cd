"""Radial lens distortion by two numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class RadialLens:
    """A lens as COLMAP's SIMPLE_RADIAL has it: what lies at (x, y), at depth 1, is shown f·(1 + k₁ r²)·(x, y) off the
    picture's middle, r² = x² + y².

    Attributes:
        focal: f over the longer side of the picture, as the lens made it.
        k1: k₁, without a unit.
    """

    focal: float
    k1: float


def middle_lens(lenses: Sequence[RadialLens]) -> RadialLens | None:
    """The one with the median focal length, a real one of them; None of none."""
    if not lenses:
        return None
    return sorted(lenses, key=lambda lens: (lens.focal, lens.k1))[(len(lenses) - 1) // 2]
