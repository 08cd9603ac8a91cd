"""How well scores tell queries for things that are there from queries for things that are not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def auroc(present: Sequence[float], absent: Sequence[float]) -> float:
    """Probability that a present thing scores above an absent one, ties half (Mann-Whitney); NaN if a side is empty."""
    if not len(present) or not len(absent):
        return float("nan")
    ordered = np.sort(np.asarray(absent, np.float64))
    below = np.searchsorted(ordered, present, "left") + np.searchsorted(ordered, present, "right")
    return float(below.mean() / (2 * len(absent)))


def false_positive_rate_at(recall: float, present: Sequence[float], absent: Sequence[float]) -> float:
    """Share of absent things that pass the highest threshold which at least `recall` of the present ones pass.

    NaN if a side is empty.
    """
    if not len(present) or not len(absent):
        return float("nan")
    needed = max(1, int(np.ceil(recall * len(present) - 1e-9)))
    threshold = np.sort(np.asarray(present, np.float64))[::-1][needed - 1]
    return float((np.asarray(absent, np.float64) >= threshold).mean())
