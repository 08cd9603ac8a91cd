"""What a question finds in one view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Mask2D:
    """Where an answer is in one view.

    Attributes:
        mask: bool [H, W], pixels whose most probable class is a relevant entry.
        label_ids: uint16 [H, W], which relevant entry each pixel of the mask is, 0 outside the mask.
        relevancy: float32 [H, W], 0..1: Σ_n p(n)·relevancy(n).
        rgb: uint8 [H, W, 3], the rendered view.
    """

    mask: NDArray[np.bool_]
    label_ids: NDArray[np.uint16]
    relevancy: NDArray[np.float32]
    rgb: NDArray[np.uint8]
