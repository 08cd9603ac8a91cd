"""Where Gaussians are needed: the arithmetic of 3DGS-MCMC's relocation (Kheradmand et al. 2024, eq. 9)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

MAX_COPIES = 16
"""No Gaussian is cut into more parts than this at once; the sums below lose precision beyond."""


def split_in_place(opacities: Tensor, scales: Tensor, copies: Tensor) -> tuple[Tensor, Tensor]:
    """Opacity and scale of each of `copies` equal parts that together look like the Gaussian they replace.

    Args:
        opacities: [G], 0..1.
        scales: [G, 3].
        copies: int [G], parts n of each, 1..`MAX_COPIES` (larger ones are clamped); 1 changes nothing.

    Returns:
        opacities [G]: 1 − (1 − o)^(1/n), and scales [G, 3]: s · o / Σ_{k<n} C(n, k+1) (−1)^k / √(k+1) · o_n^(k+1),
        which keeps the integral of the composited profile.
    """
    count = copies.clamp(1, MAX_COPIES)
    opacity = opacities.double().clamp(1e-8, 1 - 1e-8)
    part = 1 - (1 - opacity) ** (1 / count)
    powers = part[:, None] ** torch.arange(1, MAX_COPIES + 1, device=part.device)
    total = (_COEFFICIENTS.to(part.device)[count - 1] * powers).sum(dim=1)
    return part.to(opacities.dtype), (scales.double() * (opacity / total)[:, None]).to(scales.dtype)


def planned_count(run_share: float, start: int, budget: int, grow_from: float, grow_until: float) -> int:
    """How many Gaussians a run should have by now: geometric growth from `start` to `budget` over the given shares."""
    if start >= budget or run_share >= grow_until:
        return budget
    if run_share <= grow_from:
        return start
    share = (run_share - grow_from) / (grow_until - grow_from)
    return min(budget, round(start * math.exp(share * math.log(budget / start))))


def _coefficients() -> Tensor:
    """[n − 1, k] = C(n, k + 1) (−1)^k / √(k + 1)."""
    rows = [
        [math.comb(n, k + 1) * (-1) ** k / math.sqrt(k + 1) for k in range(MAX_COPIES)]
        for n in range(1, MAX_COPIES + 1)
    ]
    return torch.tensor(rows, dtype=torch.float64)


_COEFFICIENTS = _coefficients()
