"""How well label maps agree with the truth: confusion counts, IoU per label, mean IoU."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.common.dictionary import UNDETECTED
from service.common.errors import InvalidInputError


@dataclass(frozen=True)
class Confusion:
    """Pixel counts over any number of images; `+` merges two.

    Attributes:
        counts: int64 [N + 1, N + 1], row = true class, column = predicted class, class 0 = undetected.
    """

    counts: NDArray[np.int64]

    def __add__(self, other: Confusion) -> Confusion:
        return Confusion(self.counts + other.counts)

    def iou(self) -> NDArray[np.float64]:
        """[N + 1]: intersection over union of each class, NaN for a class in neither truth nor prediction."""
        hits = np.diagonal(self.counts).astype(np.float64)
        union = self.counts.sum(axis=0) + self.counts.sum(axis=1) - hits
        scores = np.full(len(hits), np.nan)
        np.divide(hits, union, out=scores, where=union > 0)
        return scores

    def mean_iou(self) -> float:
        """Mean IoU over the labels that occur in the truth (undetected is no label); NaN when none does."""
        present = self.counts.sum(axis=1) > 0
        present[UNDETECTED] = False
        return float(self.iou()[present].mean()) if present.any() else float("nan")

    def accuracy(self) -> float:
        """Share of truly labelled pixels that carry their label; NaN when there is none."""
        total = self.counts[UNDETECTED + 1 :].sum()
        return float(np.diagonal(self.counts)[UNDETECTED + 1 :].sum() / total) if total else float("nan")


def confusion(
    predicted: NDArray[np.integer], truth: NDArray[np.integer], labels: int, valid: NDArray[np.bool_] | None = None
) -> Confusion:
    """Counts of one image.

    Args:
        predicted, truth: [H, W] classes 0..labels.
        labels: N.
        valid: [H, W]; pixels that are False are not counted.

    Raises:
        InvalidInputError: shapes that differ, or a class outside 0..N.
    """
    if predicted.shape != truth.shape:
        raise InvalidInputError(f"a map of shape {predicted.shape} against {truth.shape}", field="predicted")
    chosen = np.ones(truth.shape, np.bool_) if valid is None else valid
    pair = truth[chosen].astype(np.int64), predicted[chosen].astype(np.int64)
    if any(len(side) and not 0 <= side.min() <= side.max() <= labels for side in pair):
        raise InvalidInputError(f"a class outside 0..{labels}", field="predicted/truth")
    flat = np.bincount(pair[0] * (labels + 1) + pair[1], minlength=(labels + 1) ** 2)
    return Confusion(flat.reshape(labels + 1, labels + 1).astype(np.int64))
