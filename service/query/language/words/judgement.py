"""Decisions about a question, before sentences are written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.language.words.english import NoQuestion
from fastsplat.service.query.language.words.noun_phrases import noun_phrase
from fastsplat_contract.messages.queries import Answer

Mask = NDArray[np.bool_]
Verdict = Literal["exact", "related", "absent", "possible", "undecided"]
"""Verdict on a question.

exact: the object is here; related: something close is; absent: nothing relevant is here; possible: it may be here, but
its name is unsure or only suggested; undecided: it cannot be said."""


@dataclass(frozen=True)
class Judgement:
    """Verdict on a question, and its entries."""

    verdict: Verdict  # "exact", "related" or "absent"
    relevant: Mask  # bool [N], the entries that the answer speaks of
    leading: Mask  # bool [N], those among them that lead whatever they score
    named: bool  # whether the names alone decided
    suggested: bool = False  # whether nothing bears the names of the entries, and they are merely suggested


@dataclass(frozen=True)
class Remarks:
    """Facts for the sentence that the answer's fields do not hold."""

    unchecked: str = ""  # words of the question that nothing here was checked for, see `NameMatch.unchecked`
    no_question: NoQuestion = ""  # why the text is no question in English
    doubt: str = ""  # what is taken for something that a phrase speaks of, where that is not sure
    head: str = ""  # what alone a phrase was looked up by, because nothing here is that; "" otherwise
    by_shape: bool = False  # whether surfaces without a name answer, by their shape and place
    by_looks: bool = False  # whether objects answer by their looks, whatever they are called
    other_object: bool = False  # whether what comes closest is known to be another object than the text means
    calibrated: bool = True  # whether other words than names were compared


@dataclass(frozen=True)
class Ranked:
    """Decision about a question."""

    answer: Answer  # without its outcome and its sentence
    verdict: Verdict  # what both come from
    named: bool = True  # whether the names alone decided
    standing: frozenset[int] = frozenset()  # ids of relevant labels that name what was asked for or a kind of it
    remarks: Remarks = Remarks()  # what else the sentence says

    @property
    def noun_phrase(self) -> str:
        """What the text asks for, without question words, articles and politeness."""
        return self.remarks.head or noun_phrase(self.answer.text)
