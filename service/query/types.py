"""Questions and answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Verdict = Literal["exact", "related", "absent"]


@dataclass(frozen=True)
class Match:
    """One dictionary entry held against one query.

    Attributes:
        label_id: dictionary id, from 1.
        label: the entry's name.
        relevancy: min_j σ(t (d·q − d·c_j)), 0..1 (LERF's relevancy, text against text).
        similarity: cosine of the entry's and the query's embeddings, −1..1.
        nearest_negative: the canonical negative that set the relevancy.
        gaussian_count: Gaussians whose most probable class is this entry.
        relevant: whether the answer speaks of this entry: for `exact` the thing itself and nothing else, for
            `related` every entry that passes the encoder's threshold.
    """

    label_id: int
    label: str
    relevancy: float
    similarity: float
    nearest_negative: str
    gaussian_count: int
    relevant: bool


@dataclass(frozen=True)
class Answer:
    """All entries of a scene's dictionary, best first.

    Attributes:
        text: the query as asked.
        verdict: `exact`: an entry is the thing asked for; `related`: something close is here, and its label says what;
            `absent`: nothing relevant is here.
        matches: every entry; relevant ones lead, each group by descending score (`QuerySettings.score`: similarity,
            or relevancy as in the paper).
        explanation: one sentence for people, e.g. 'No "fork" here; the closest is "spoon".'
    """

    text: str
    verdict: Verdict
    matches: tuple[Match, ...]
    explanation: str

    @property
    def relevant_ids(self) -> tuple[int, ...]:
        """Label ids of the relevant entries, best first; empty when absent."""
        return tuple(match.label_id for match in self.matches if match.relevant)


@dataclass(frozen=True)
class Mask2D:
    """Where an answer is in one view.

    Attributes:
        mask: bool [H, W], pixels whose most probable class is a relevant entry.
        label_ids: uint16 [H, W], which relevant entry each pixel of the mask is, 0 outside the mask.
        relevancy: float32 [H, W], 0..1: Σ_n p(n)·relevancy(n).
        rgb: uint8 [H, W, 3], the rendered view.
    """

    mask: NDArray[np.bool_]
    label_ids: NDArray[np.uint16]
    relevancy: NDArray[np.float32]
    rgb: NDArray[np.uint8]
