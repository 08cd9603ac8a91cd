"""How well scores tell what is there from what is not, and where to part them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

F64 = NDArray[np.float64]


def auroc(positive: F64, negative: F64) -> float:
    """Probability that a positive scores above a negative, ties half."""
    difference = positive[:, None] - negative[None, :]
    return float((difference > 0).mean() + 0.5 * (difference == 0).mean())


def calibration_error(probability: F64, truth: F64, weights: F64 | None = None, bins: int = 10) -> float:
    """Expected calibration error over bins of equal count.

    Args:
        probability, truth: [N], 0..1.
        weights: [N], of each; None: all weigh the same.
        bins: how many.
    """
    mass = np.ones(len(probability)) if weights is None else weights
    parts = np.array_split(probability.argsort(), bins)
    return float(sum(abs((mass * (probability - truth))[part].sum()) for part in parts) / mass.sum())


def equal_loss(positive: F64, negative: F64) -> float:
    """The threshold below which as large a share of the positives lies as of the negatives at or above it; where no
    score has it so, the middle of the two nearest.

    Args:
        positive, negative: scores, at least one each.
    """
    scores = np.unique(np.concatenate([positive, negative]))
    lost = np.searchsorted(np.sort(positive), scores, side="left") / len(positive)
    accepted = 1.0 - np.searchsorted(np.sort(negative), scores, side="left") / len(negative)
    first = int(np.argmax(lost >= accepted)) if (lost >= accepted).any() else len(scores) - 1
    return float(scores[first] if first == 0 else (scores[first - 1] + scores[first]) / 2)


def balanced(truth: NDArray[np.bool_]) -> F64:
    """[N]: weights by which those that are true and those that are not weigh the same together; mean 1."""
    share = truth.mean()
    return np.where(truth, 0.5 / share, 0.5 / (1.0 - share)) if 0 < share < 1 else np.ones(len(truth))


def logistic_fit(features: F64, truth: NDArray[np.bool_], weights: F64 | None = None) -> list[float]:
    """Factors and offset of the logistic regression of truth [R] on features [R, F], by maximum likelihood, each row
    with its weight [R], and a ridge so weak that it only matters where the classes separate."""
    mass = np.ones(len(truth)) if weights is None else weights
    columns = np.column_stack([features, np.ones(len(features))])
    sign = np.where(truth, 1.0, -1.0)

    def loss(factors: F64) -> float:
        ridge = 1e-3 * float((factors[:-1] ** 2).sum()) / len(columns)
        return float((mass * np.logaddexp(0.0, -sign * (columns @ factors))).mean()) + ridge

    optimum = minimize(loss, np.zeros(columns.shape[1]), method="BFGS")
    return [round(float(weight), 3) for weight in optimum.x]
