"""A photo of another day beside what its scene shows from there, and where their colors differ."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.localization.photometric_refinement import Comparison

F32 = NDArray[np.float32]
Bools = NDArray[np.bool_]

_SLACK_PX = 5
"""Width of the window in which either picture may have the color of the other one: poses are a pixel or two off."""
_LEAST = 0.07
"""Of a color channel, 0..1, beyond what the other picture has around there."""
_TIMES_USUAL = 3.0
"""As many times the usual difference, where the scene is reproduced badly everywhere."""
_WINDOW_PX = 9
_SHADED = (0.45, 1.7)
"""Gains between a surface in light and in shade."""
_SAME_CHROMA = 0.035
_BURNT, _BRIGHT = 0.985, 0.8
_WIDE = np.ones((7, 7), np.uint8)


@dataclass(frozen=True)
class LaterView:
    """A photo of another day in its place.

    Attributes:
        things: int32 [H, W], the thing that the scene shows at each pixel of the comparison, 0 for none.
    """

    comparison: Comparison
    things: NDArray[np.int32]

    @cached_property
    def missing(self) -> Bools:
        """bool [H, W], where the scene has a color that the photo has nowhere around."""
        return _differs(self.comparison.shown, self.comparison.photo, self.comparison.sure)

    @cached_property
    def only_in_scene(self) -> Bools:
        """bool [H, W], where the scene shows what the photo has not, shades left out."""
        return self._shaped(self.missing)

    @cached_property
    def only_in_photo(self) -> Bools:
        """bool [H, W], where the photo shows what the scene has not, shades left out; how far away the scene is there
        need not be sure, as of a plain wall it never is."""
        return self._shaped(_differs(self.comparison.photo, self.comparison.shown, self.comparison.covered))

    @property
    def same(self) -> Bools:
        """bool [H, W], where photo and scene show the same, surely."""
        return np.asarray(self.comparison.sure & ~self.only_in_scene & ~self.only_in_photo)

    def unknown(self, aside: Bools, known: Bools) -> Bools:
        """bool [H, W], where it cannot be told which of them shows something: around what is set `aside`, and off what
        is `known` of the scene."""
        near = cv2.dilate(aside.astype(np.uint8), _WIDE) > 0
        return np.asarray(near | _burnt(self.comparison) | ~known)

    def _shaped(self, differs: Bools) -> Bools:
        seen = (differs & ~_only_shaded(self.comparison)).astype(np.uint8)
        return np.asarray(cv2.morphologyEx(seen, cv2.MORPH_CLOSE, _WIDE) > 0)


def _differs(one: F32, other: F32, known: Bools) -> Bools:
    """bool [H, W]: where one picture has a color that the other one has nowhere around, of what is known."""
    around = np.ones((_SLACK_PX, _SLACK_PX), np.uint8)
    soft_one, soft_other = (cv2.GaussianBlur(picture.clip(0.0, 1.0), (0, 0), 1.0) for picture in (one, other))
    beyond = np.maximum(soft_one - cv2.dilate(soft_other, around), cv2.erode(soft_other, around) - soft_one)
    excess = np.maximum(beyond, 0.0).max(axis=2)
    if not known.any():
        return np.zeros(excess.shape, np.bool_)
    usual = float(excess[known].mean())
    return np.asarray((excess > max(_LEAST, _TIMES_USUAL * usual)) & known)


def _burnt(comparison: Comparison) -> Bools:
    """Where the photo is as bright as it can be, and the scene bright: what it would show is not known."""
    white = (comparison.photo > _BURNT) & (comparison.shown > _BRIGHT)
    return cv2.dilate(np.asarray(white.any(axis=2), np.uint8), np.ones((3, 3), np.uint8)) > 0


def _only_shaded(comparison: Comparison) -> Bools:
    """Where the photo has the scene's color but for its brightness: a shadow that came or went."""
    photo, shown = (cv2.blur(picture, (_WINDOW_PX, _WINDOW_PX)) for picture in (comparison.photo, comparison.shown))
    gain = photo.sum(axis=2) / np.maximum(shown.sum(axis=2), 1e-3)
    rest = np.abs(photo - gain[..., None] * shown).max(axis=2)
    return np.asarray((gain > _SHADED[0]) & (gain < _SHADED[1]) & (rest < _SAME_CHROMA))
