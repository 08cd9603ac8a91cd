"""What the perception room hands on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.common.dictionary import Dictionary


@dataclass(frozen=True)
class Labelling:
    """The scene's dictionary and one label map per view.

    Attributes:
        dictionary: all labels of all views, with pixel and view counts.
        label_maps: one uint16 [H, W] per view of the capture, in its order, of its image size; 0 is undetected.
    """

    dictionary: Dictionary
    label_maps: tuple[NDArray[np.uint16], ...]

    def __post_init__(self) -> None:
        for label_map in self.label_maps:
            assert label_map.ndim == 2 and label_map.dtype == np.uint16
            assert int(label_map.max(initial=0)) <= len(self.dictionary)
