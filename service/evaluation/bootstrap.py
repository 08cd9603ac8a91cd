"""How sure a figure is: percentile bootstrap over images."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

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

    Images, not pixels, are drawn: pixels of one image are not independent.

    Args:
        items: what was measured per image.
        statistic: of any such list; a NaN draw (nothing to measure in it) is left out.

    Returns:
        The interval, or None with fewer than two items or when most draws have nothing to measure.
    """
    if len(items) < 2:
        return None
    random = np.random.default_rng(seed)
    draws = random.integers(0, len(items), (samples, len(items)))
    values = [statistic([items[index] for index in draw]) for draw in draws.tolist()]
    finite = [value for value in values if math.isfinite(value)]
    if len(finite) * 2 < samples:
        return None
    low, high = np.quantile(finite, [(1 - coverage) / 2, (1 + coverage) / 2])
    return float(low), float(high)
