"""Texts about the labels of a dictionary, embedded: what a question lies nearest to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.language.meaning.embeddings import TextCache
from fastsplat.service.query.language.meaning.relevancy import F32, F64

UNKNOWN = 0.6
"""Share of the cosine with a label's name that stands in for one with what is not known of it."""
_NOTHING = "thing"
"""Embedded where there is no text of a label; masked."""


class LabelTexts:
    """Some texts of each of N labels. Threads may share it.

    Args:
        texts: of each label.
        cache: embeds them as they are.

    Raises:
        ModelUnavailableError: the encoder answers with something else than embeddings.
    """

    def __init__(self, texts: Sequence[Sequence[str]], cache: TextCache) -> None:
        flat = [text for each in texts for text in each or (_NOTHING,)]
        self._embedded = cache.embed(flat, ("{}",)) if flat else np.zeros((0, 0), dtype=np.float32)
        self._starts = np.cumsum([0, *(len(each) or 1 for each in texts)])[:-1].astype(np.intp)
        self._known: NDArray[np.bool_] = np.array([bool(each) for each in texts], dtype=np.bool_)

    @property
    def nbytes(self) -> int:
        """What the embeddings weigh."""
        return self._embedded.nbytes

    def nearest(self, question: F32, otherwise: F64) -> F64:
        """float64 [N]: the cosine of a question with the nearest text of each label.

        Args:
            question: float32 [E], unit length.
            otherwise: float64 [N], what stands in for labels without a text.
        """
        if not len(self._known):
            return otherwise
        return np.where(self._known, np.maximum.reduceat(self._embedded @ question, self._starts), otherwise)
