"""Embedded texts about labels, searched for the nearest to a question."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.language.meaning.embeddings import TextCache
from fastsplat.service.query.language.meaning.relevancy import F32, F64

UNKNOWN = 0.6
"""Share of the cosine with a label's name that replaces unknown cosines."""
_NOTHING = "thing"
"""Placeholder for labels without a text; masked."""


class LabelTexts:
    """Texts of each of N labels, embedded without templates; thread-safe."""

    def __init__(self, texts: Sequence[Sequence[str]], cache: TextCache) -> None:
        flat = [text for row_texts in texts for text in row_texts or (_NOTHING,)]
        self._embedded = cache.embed(flat, ("{}",)) if flat else np.zeros((0, 0), dtype=np.float32)
        self._starts = np.cumsum([0, *(len(row_texts) or 1 for row_texts in texts)])[:-1].astype(np.intp)
        self._known: NDArray[np.bool_] = np.array([bool(row_texts) for row_texts in texts], dtype=np.bool_)

    @property
    def nbytes(self) -> int:
        """Bytes of the embeddings."""
        return self._embedded.nbytes

    def nearest(self, question: F32, otherwise: F64) -> F64:
        """Cosine of a question [E] with each label's nearest text, float64 [N], or `otherwise`."""
        if not len(self._known):
            return otherwise
        return np.where(self._known, np.maximum.reduceat(self._embedded @ question, self._starts), otherwise)
