"""What is decided of a question, before it is put into words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.language.english import NoQuestion
from fastsplat_contract.queries import Answer

Mask = NDArray[np.bool_]
Verdict = Literal["exact", "related", "absent", "possible", "undecided"]
"""exact: the thing asked for is here; related: something close is; absent: nothing relevant is here; possible: it may
be here, but its name is not sure or only suggested; undecided: it cannot be said."""


@dataclass(frozen=True)
class Judgement:
    """The verdict on a question, and the entries it is about.

    Attributes:
        verdict: "exact", "related" or "absent".
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


@dataclass(frozen=True)
class Remarks:
    """What a sentence says beside what the answer's members hold.

    Attributes:
        unchecked: words of the question that nothing here was checked for, see `NameMatch.unchecked`.
        no_question: why the text is no question in English.
        doubt: what is taken for something that a phrase speaks of, where that is not sure.
        head: what alone a phrase was looked up by, because nothing here is that; "" otherwise.
        by_shape: whether surfaces without a name answer, by their shape and place.
        by_looks: whether things answer by their looks, whatever they are called.
        other: whether what comes closest is known to be another thing than the one that was asked for.
        calibrated: whether other words than names were compared.
    """

    unchecked: str = ""
    no_question: NoQuestion = ""
    doubt: str = ""
    head: str = ""
    by_shape: bool = False
    by_looks: bool = False
    other: bool = False
    calibrated: bool = True


@dataclass(frozen=True)
class Ranked:
    """What is decided of a question.

    Attributes:
        answer: without its outcome and its sentence.
        verdict: what both come from.
        named: whether the names alone decided.
        standing: the ids of those of its labels that name what was asked for, or a kind of it, and do not merely serve
            in its place.
        remarks: what else the sentence says.
    """

    answer: Answer
    verdict: Verdict
    named: bool = True
    standing: frozenset[int] = frozenset()
    remarks: Remarks = Remarks()
