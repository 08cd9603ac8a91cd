"""Confidence intervals: the percentile bootstrap over images, by scipy."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import stats

_T = TypeVar("_T")

Interval = tuple[float, float]


def bootstrap_interval(
    items: Sequence[_T],
    statistic: Callable[[Sequence[_T]], float],
    *,
    samples: int = 1000,
    coverage: float = 0.95,
    seed: int = 0,
) -> Interval | None:
    """Percentile interval of `statistic` over resamples of `items` with replacement (Efron 1979).

    Images, not pixels, are resampled: pixels of one image are not independent.

    Args:
        items: what was measured in each image.
        statistic: of any such list; a resample where it is NaN (nothing to measure) is left out.
        samples: number of resamples.
        coverage: 0..1.
        seed: of the resampling.

    Returns:
        The interval, or None with fewer than two items or when most resamples have nothing to measure.
    """
    if len(items) < 2:
        return None

    def of_rows(rows: NDArray[np.int64]) -> float:
        return statistic([items[row] for row in rows.tolist()])

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)  # of resamples with nothing to measure, see below
        result = stats.bootstrap(
            (np.arange(len(items)),),
            of_rows,
            vectorized=False,
            n_resamples=samples,
            confidence_level=coverage,
            method="percentile",
            rng=np.random.default_rng(seed),
        )
    finite = result.bootstrap_distribution[np.isfinite(result.bootstrap_distribution)]
    if len(finite) * 2 < samples:
        return None
    low, high = np.quantile(finite, [(1 - coverage) / 2, (1 + coverage) / 2])  # scipy's own is NaN if any resample is
    return float(low), float(high)
