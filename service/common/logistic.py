"""Logistic function of arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def logistic(x: NDArray[np.float32] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Computes 1 / (1 + exp(-x)) without overflow."""
    # Not scipy's `expit`: commands that import `service.query` would load all of scipy.
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x.astype(np.float64))))
