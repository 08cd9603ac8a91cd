"""Combines independent estimates of one ratio, e.g. of a scale."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

NORMAL_95 = 1.959964
"""Standard deviations that hold 95 % of a normal distribution."""


def combined_ratio(ratios: Sequence[float], variances: Sequence[float]) -> tuple[float, float]:
    """Returns the best ratio of one or more estimates, and its relative standard deviation.

    ln r = V · Σ ln(r_i) / v_i with variance V = 1 / Σ 1/v_i, times χ² / (n - 1) if that is above 1 (Birge 1932). The
    variances v_i are relative.
    """
    logs, weights = np.log(ratios), 1 / np.asarray(variances, np.float64)
    log_ratio, variance = float(weights @ logs / weights.sum()), 1 / float(weights.sum())
    if len(logs) > 1:
        variance *= max(1.0, float(weights @ (logs - log_ratio) ** 2) / (len(logs) - 1))
    return math.exp(log_ratio), math.sqrt(variance)
