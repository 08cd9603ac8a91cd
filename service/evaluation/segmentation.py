"""How well label maps agree with the truth: confusion counts, IoU per label, mean IoU."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.evaluation.masks import MaskCounts
from fastsplat_contract.errors import InvalidInputError


@dataclass(frozen=True)
class Confusion:
    """Pixel counts over any number of images; `+` merges two.

    Attributes:
        counts: int64 [N + 1, N + 1], row = true class, column = predicted class, class 0 = undetected.
    """

    counts: NDArray[np.int64]

    def __add__(self, other: Confusion) -> Confusion:
        return Confusion(self.counts + other.counts)

    def masks(self) -> MaskCounts:
        """The counts of each class's mask."""
        return MaskCounts(
            np.stack([np.diagonal(self.counts), self.counts.sum(axis=1), self.counts.sum(axis=0)], axis=1)
        )


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
    check_maps(predicted, truth, labels)
    chosen = np.ones(truth.shape, np.bool_) if valid is None else valid
    pair = truth[chosen].astype(np.int64) * (labels + 1) + predicted[chosen].astype(np.int64)
    flat = np.bincount(pair, minlength=(labels + 1) ** 2)
    return Confusion(flat.reshape(labels + 1, labels + 1).astype(np.int64))


def mask_counts(
    predicted: NDArray[np.integer], truth: NDArray[np.integer], labels: int, valid: NDArray[np.bool_] | None = None
) -> MaskCounts:
    """As `confusion(...).masks()`, in memory that grows with the labels and not with their square."""
    check_maps(predicted, truth, labels)
    chosen = np.ones(truth.shape, np.bool_) if valid is None else valid
    true, found = truth[chosen].astype(np.int64), predicted[chosen].astype(np.int64)
    columns = (true[true == found], true, found)
    return MaskCounts(np.stack([np.bincount(column, minlength=labels + 1) for column in columns], axis=1))


def check_maps(predicted: NDArray[np.integer], truth: NDArray[np.integer], labels: int) -> None:
    """Raise `InvalidInputError` unless both are [H, W] maps of one shape with classes 0..labels."""
    if predicted.shape != truth.shape:
        raise InvalidInputError(f"a map of shape {predicted.shape} against {truth.shape}", field="predicted")
    if any(side.size and not 0 <= side.min() <= side.max() <= labels for side in (predicted, truth)):
        raise InvalidInputError(f"a class outside 0..{labels}", field="predicted/truth")
