"""Agreement of label maps with the truth: counts, IoU per label, mean IoU."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.evaluation.metrics import Skipped, ViewMetric, ViewPrediction
from fastsplat.service.common.dictionary import UNDETECTED
from fastsplat_contract.errors import InvalidInputError

NO_TRUTH = "the view has neither a label map nor an annotated text"


@dataclass(frozen=True)
class MaskCounts:
    """Pixels (or Gaussians) of masks; `+` merges two sets of images.

    Attributes:
        counts: int64 [N + 1, 3]: for each class those in both masks, in the true one, in the predicted one.
    """

    counts: NDArray[np.int64]

    def __add__(self, more: MaskCounts) -> MaskCounts:
        return MaskCounts(self.counts + more.counts)

    @staticmethod
    def zeros(labels: int) -> MaskCounts:
        """Counts of no image, for N labels."""
        return MaskCounts(np.zeros((labels + 1, 3), np.int64))

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


def mask_counts(
    predicted: NDArray[np.integer], truth: NDArray[np.integer], labels: int, valid: NDArray[np.bool_] | None = None
) -> MaskCounts:
    """Counts of one image.

    Args:
        predicted, truth: [H, W] classes 0..labels.
        labels: N.
        valid: [H, W]; pixels that are False are not counted.

    Raises:
        InvalidInputError: shapes that differ, or a class outside 0..N.
    """
    check_maps(predicted, truth, labels)
    counted = np.ones(truth.shape, np.bool_) if valid is None else valid
    true, guess = truth[counted].astype(np.int64), predicted[counted].astype(np.int64)
    columns = (true[true == guess], true, guess)
    return MaskCounts(np.stack([np.bincount(column, minlength=labels + 1) for column in columns], axis=1))


def check_maps(predicted: NDArray[np.integer], truth: NDArray[np.integer], labels: int) -> None:
    """Raise `InvalidInputError` unless both are [H, W] maps of one shape with classes 0..labels."""
    if predicted.shape != truth.shape:
        raise InvalidInputError(f"a map of shape {predicted.shape} against {truth.shape}", field="predicted")
    if any(side.size and not 0 <= side.min() <= side.max() <= labels for side in (predicted, truth)):
        raise InvalidInputError(f"a class outside 0..{labels}", field="predicted/truth")


def overlap(
    predicted: NDArray[np.bool_], truth: NDArray[np.bool_], valid: NDArray[np.bool_] | None
) -> tuple[int, int, int]:
    """Valid pixels [H, W] in both masks, in the true one, in the predicted one."""
    if valid is not None:
        predicted, truth = predicted & valid, truth & valid
    return int((predicted & truth).sum()), int(truth.sum()), int(predicted.sum())


def total(counts: Sequence[MaskCounts]) -> MaskCounts:
    """The sum of the counts of at least one image."""
    return sum(counts[1:], counts[0])


def closed_set_counts(view: ViewPrediction) -> MaskCounts | Skipped:
    """Counts of the masks by argmax over the scene's labels; without a label map, of the annotated texts' masks."""
    labels, truth = len(view.dictionary), view.truth
    if truth.labels is not None:
        return mask_counts(view.label_map, truth.labels, labels, truth.valid)
    if not view.queries:
        return Skipped(NO_TRUTH)
    counts = MaskCounts.zeros(labels).counts
    for query in view.queries:
        counts[query.label_id] += overlap(query.leading_mask, query.truth.mask, truth.valid)
    return MaskCounts(counts)


MIOU = ViewMetric(
    name="miou",
    description="IoU of the masks by argmax over the scene's labels; pixels pooled over the test views, mean over the "
    "labels that the truth shows, so that a label predicted where the truth has none costs nothing",
    measure=closed_set_counts,
    combine=lambda counts: total(counts).macro_iou(),
)
