"""Compares the colors of a later photo with the scene's rendering from its pose."""

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
"""Window in which colors are matched, as poses are a pixel or two off."""
_LEAST = 0.07
"""Least color difference, 0..1, beyond the other picture's range in the window."""
_TIMES_USUAL = 3.0
"""Factor on the mean difference that a change exceeds, for badly reproduced scenes."""
_WINDOW_PX = 9
_SHADED = (0.45, 1.7)  # gains between lit and shaded surfaces
_SAME_CHROMA = 0.035
_BURNT, _BRIGHT = 0.985, 0.8
_WIDE = np.ones((7, 7), np.uint8)


@dataclass(frozen=True)
class LaterView:
    """A later photo beside the scene."""

    comparison: Comparison
    objects: NDArray[np.int32]  # [H, W], id of the visible object in the scene, 0 for none

    @cached_property
    def missing(self) -> Bools:
        """Pixels whose color in the scene the photo has nowhere around, bool [H, W]."""
        return _differs(self.comparison.rendering, self.comparison.photo, self.comparison.sure)

    @cached_property
    def only_in_scene(self) -> Bools:
        """Changed pixels of the scene, without shadows, bool [H, W]."""
        return self._shaped(self.missing)

    @cached_property
    def only_in_photo(self) -> Bools:
        """Changed pixels of the photo, without shadows, bool [H, W].

        Depth need not be sure, as it never is on plain walls.
        """
        return self._shaped(_differs(self.comparison.photo, self.comparison.rendering, self.comparison.covered))

    @property
    def same(self) -> Bools:
        """Pixels where photo and scene surely agree, bool [H, W]."""
        return np.asarray(self.comparison.sure & ~self.only_in_scene & ~self.only_in_photo)

    def unknown(self, aside: Bools, known: Bools) -> Bools:
        """Pixels without evidence, bool [H, W]: near `aside`, overexposed, or not `known`."""
        near = cv2.dilate(aside.astype(np.uint8), _WIDE) > 0
        return np.asarray(near | _burnt(self.comparison) | ~known)

    def _shaped(self, differs: Bools) -> Bools:
        seen = (differs & ~_only_shaded(self.comparison)).astype(np.uint8)
        return np.asarray(cv2.morphologyEx(seen, cv2.MORPH_CLOSE, _WIDE) > 0)


def _differs(image: F32, other_image: F32, known: Bools) -> Bools:
    """Known pixels whose color in `image` the other picture has nowhere around, bool [H, W]."""
    around = np.ones((_SLACK_PX, _SLACK_PX), np.uint8)
    soft, soft_other = (cv2.GaussianBlur(picture.clip(0.0, 1.0), (0, 0), 1.0) for picture in (image, other_image))
    beyond = np.maximum(soft - cv2.dilate(soft_other, around), cv2.erode(soft_other, around) - soft)
    excess = np.maximum(beyond, 0.0).max(axis=2)
    if not known.any():
        return np.zeros(excess.shape, np.bool_)
    usual = float(excess[known].mean())
    return np.asarray((excess > max(_LEAST, _TIMES_USUAL * usual)) & known)


def _burnt(comparison: Comparison) -> Bools:
    """Overexposed pixels of the photo where the scene is bright, too: their content is unknown."""
    white = (comparison.photo > _BURNT) & (comparison.rendering > _BRIGHT)
    return cv2.dilate(np.asarray(white.any(axis=2), np.uint8), np.ones((3, 3), np.uint8)) > 0


def _only_shaded(comparison: Comparison) -> Bools:
    """Pixels that differ in brightness only: a shadow came or went."""
    photo, rendering = (
        cv2.blur(picture, (_WINDOW_PX, _WINDOW_PX)) for picture in (comparison.photo, comparison.rendering)
    )
    gain = photo.sum(axis=2) / np.maximum(rendering.sum(axis=2), 1e-3)
    rest = np.abs(photo - gain[..., None] * rendering).max(axis=2)
    return np.asarray((gain > _SHADED[0]) & (gain < _SHADED[1]) & (rest < _SAME_CHROMA))
