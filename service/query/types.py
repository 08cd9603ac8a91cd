"""Questions and answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

Verdict = Literal["exact", "related", "absent"]


class Match(NamedTuple):
    """One dictionary entry held against one query. A tuple, because a ranking makes as many as there are labels and a
    frozen dataclass takes four times as long.

    Attributes:
        label_id: dictionary id, from 1.
        label: the entry's name.
        relevancy: min_j σ(t (d·q − d·c_j)), 0..1 (LERF's relevancy, text against text).
        similarity: cosine of the entry's and the query's embeddings, −1..1.
        nearest_negative: the canonical negative that set the relevancy.
        gaussian_count: Gaussians whose most probable class is this entry.
        relevant: whether the answer speaks of this entry: for `exact` the thing itself and nothing else, for
            `related` the entries that pass the encoder's threshold and come close enough to the best of them.
        probability: calibrated probability, 0..1, that who asked for the text wants to be shown this entry; entries are
            judged one by one, so that several may be likely and the sum means nothing. None: the encoder was not
            calibrated with these prompts.
    """

    label_id: int
    label: str
    relevancy: float
    similarity: float
    nearest_negative: str
    gaussian_count: int
    relevant: bool
    probability: float | None = None


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
        probability: calibrated probability, 0..1, that the verdict is right: for `exact` and `related` that the leading
            entry answers, for `absent` that nothing here does. None: the encoder was not calibrated with these
            prompts.
        presence: calibrated probability, 0..1, that anything here answers, whatever the verdict: answers of different
            texts or scenes are ordered by it. None as `probability`.
        label_set: label ids of which one at least answers, with probability `coverage` or more; likeliest first. Id 0
            in it stands for "nothing here": alone, that is as good as sure. Empty if the encoder was not calibrated.
        coverage: the coverage that was asked for, 0..1 (split conformal prediction; the unit is a question to a scene
            of its own). None: the encoder was not calibrated with these prompts, so nothing is promised.
        decided_by: `name`: the hash table knew the name; `score`: the verdict comes from `threshold`.
        threshold: the score (`QuerySettings.score`) that the leading entry was held against: what it passed, or for
            `absent` what it missed. None if a name decided, or without calibration.
    """

    text: str
    verdict: Verdict
    matches: tuple[Match, ...]
    explanation: str
    probability: float | None = None
    label_set: tuple[int, ...] = ()
    coverage: float | None = None
    decided_by: Literal["name", "score"] = "score"
    threshold: float | None = None
    presence: float | None = None

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
