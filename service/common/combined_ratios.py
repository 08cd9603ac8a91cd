"""Combination of several estimates of one ratio, as of a scale, into a surer one."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

NORMAL_95 = 1.959964
"""Of a normal distribution 95 % is within so many standard deviations."""


def combined_ratio(ratios: Sequence[float], variances: Sequence[float]) -> tuple[float, float]:
    """The ratio that fits independent estimates best, and its relative standard deviation: ln r = V · Σ ln(r_i) / v_i,
    its variance V = 1 / Σ 1/v_i, times χ² / (n - 1) where that is more than 1 (Birge 1932).

    Args:
        ratios: at least one, positive.
        variances: v_i, relative, positive.
    """
    logs, weights = np.log(ratios), 1 / np.asarray(variances, np.float64)
    log_ratio, variance = float(weights @ logs / weights.sum()), 1 / float(weights.sum())
    if len(logs) > 1:
        variance *= max(1.0, float(weights @ (logs - log_ratio) ** 2) / (len(logs) - 1))
    return math.exp(log_ratio), math.sqrt(variance)
