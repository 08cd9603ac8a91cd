"""Intersection and union of masks, one per class, over any number of images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import UNDETECTED


@dataclass(frozen=True)
class MaskCounts:
    """Pixels (or Gaussians) of masks; `+` merges two sets of images.

    Attributes:
        counts: int64 [N + 1, 3]: for each class those in both masks, in the true one, in the predicted one.
    """

    counts: NDArray[np.int64]

    def __add__(self, other: MaskCounts) -> MaskCounts:
        return MaskCounts(self.counts + other.counts)

    def iou(self) -> NDArray[np.float64]:
        """[N + 1]: intersection over union of each class, NaN for a class in neither truth nor prediction."""
        both, truth, predicted = self.counts.T
        union = truth + predicted - both
        scores = np.full(len(both), np.nan)
        np.divide(both, union, out=scores, where=union > 0)
        return scores

    def present(self) -> NDArray[np.bool_]:
        """[N + 1]: the labels that occur in the truth; undetected is no label."""
        present = self.counts[:, 1] > 0
        present[UNDETECTED] = False
        return np.asarray(present)

    def macro_iou(self) -> float:
        """Mean of the IoUs of the labels that occur in the truth, each label the same weight; NaN when none does."""
        present = self.present()
        return float(self.iou()[present].mean()) if present.any() else float("nan")

    def micro_iou(self) -> float:
        """Σ intersections / Σ unions over the labels in truth or prediction, each pixel the same weight; NaN when
        there are none. A label where the truth has none counts against it, which `macro_iou` does not see."""
        both, truth, predicted = self.counts[UNDETECTED + 1 :].sum(axis=0)
        union = truth + predicted - both
        return float(both / union) if union else float("nan")

    def accuracy(self) -> float:
        """Share of the truth's labelled pixels that the prediction of the same label covers; NaN when there is none."""
        both, truth, _ = self.counts[UNDETECTED + 1 :].sum(axis=0)
        return float(both / truth) if truth else float("nan")
