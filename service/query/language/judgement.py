"""What is decided of a question, before it is put into words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat_contract.queries import Verdict

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Judgement:
    """The verdict of an answer, and the entries it is about.

    Attributes:
        verdict: see `Answer`.
        relevant: bool [N], the entries that the answer speaks of.
        leading: bool [N], those among them that lead whatever they score.
        named: whether the names alone decided.
        suggested: whether nothing bears the names of the entries, and they are merely suggested.
    """

    verdict: Verdict
    relevant: Mask
    leading: Mask
    named: bool
    suggested: bool = False
