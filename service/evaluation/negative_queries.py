"""Questions for things that are not in a scene: lists of nouns, and how well the answers tell them apart."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from scipy.stats import mannwhitneyu

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.evaluation.types import EvaluatedScene, SceneFigure, SceneMetric, Skipped
from fastsplat.service.query.language.query_text import MAX_TEXTS
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.queries import Answer

RECALL = 0.95

NounList = Literal["nouns", "household"]
"""`nouns`: things that fit on no table and in no kitchen. `household`: things that might well be there, for scenes
whose truth names everything in them."""


@dataclass(frozen=True)
class NegativeQueries:
    """Answers to texts for things that are there, compared with answers to texts for things that are not.

    Attributes:
        auroc: of the answers' presence, see `presence_scores`.
        false_positives: share of negative texts that pass the threshold which 95 % of the positive ones pass.
        said_absent: share of negative texts whose verdict is `absent`.
        said_present: share of positive texts whose verdict is not.
        texts: number of negative texts.
        worst: the negative texts with the highest presence, at most ten.
    """

    auroc: float
    false_positives: float
    said_absent: float
    said_present: float
    texts: int
    worst: tuple[str, ...]


def measure_negative_queries(
    index: SceneIndex, positive: Sequence[str], negative: Sequence[str]
) -> NegativeQueries | None:
    """None when one of the sides has no text."""
    if not positive or not negative:
        return None
    answers = ask_all(index, [*positive, *negative])
    to_positive, to_negative = answers[: len(positive)], answers[len(positive) :]
    scores = presence_scores(answers)
    high, low = scores[: len(positive)], scores[len(positive) :]
    worst = sorted(zip(low, negative, strict=True), reverse=True)[:10]
    return NegativeQueries(
        auroc=auroc(high, low),
        false_positives=false_positive_rate_at(RECALL, high, low),
        said_absent=sum(answer.is_absent for answer in to_negative) / len(negative),
        said_present=sum(not answer.is_absent for answer in to_positive) / len(positive),
        texts=len(negative),
        worst=tuple(text for _, text in worst),
    )


def negative_nouns(labels: Iterable[str], which: NounList = "nouns") -> tuple[str, ...]:
    """The nouns of a list that name nothing among `labels`.

    A noun is dropped when it shares a word with a label ("race car" where there is a "toy car"): it might be there.
    """
    words = {word for label in labels for word in label_key(label).split()}
    return tuple(noun for noun in _nouns(which) if not words & set(label_key(noun).split()))


def presence_scores(answers: Sequence[Answer]) -> list[float]:
    """How likely the thing is there by each answer: its calibrated presence, or, where the encoder is not calibrated,
    the similarity of the entry that is most alike."""
    calibrated = [answer.presence for answer in answers if answer.presence is not None]
    if len(calibrated) == len(answers):
        return calibrated
    return [max((match.similarity for match in answer.matches), default=-1.0) for answer in answers]


def ask_all(index: SceneIndex, texts: Sequence[str]) -> list[Answer]:
    """Answers to any number of texts, in order."""
    step = MAX_TEXTS
    return [answer for start in range(0, len(texts), step) for answer in index.ask(texts[start : start + step])]


def auroc(positive: Sequence[float], negative: Sequence[float]) -> float:
    """Probability that a positive scores above a negative, ties half: the area under the ROC curve, as the Mann-Whitney
    statistic in float64 (scipy's, for no further dependency); NaN if a side is empty."""
    if not len(positive) or not len(negative):
        return float("nan")
    with np.errstate(divide="ignore", invalid="ignore"):  # of its p-value, where all scores are equal
        statistic = mannwhitneyu(positive, negative, method="asymptotic").statistic
    return float(statistic / (len(positive) * len(negative)))


def false_positive_rate_at(recall: float, positive: Sequence[float], negative: Sequence[float]) -> float:
    """Share of negatives that pass the highest threshold which at least `recall` of the positives pass; NaN if a side
    is empty."""
    if not len(positive) or not len(negative):
        return float("nan")
    needed = max(1, int(np.ceil(recall * len(positive) - 1e-9)))
    threshold = np.sort(np.asarray(positive, np.float64))[::-1][needed - 1]
    return float((np.asarray(negative, np.float64) >= threshold).mean())


def measure_absent_auroc(scene: EvaluatedScene) -> SceneFigure | Skipped:
    """The AUROC against the list `nouns`; both lists' figures are among the details."""
    entries = (*scene.dataset.dictionary.entries, *scene.index.scene.dictionary.entries)
    known = [entry.label for entry in entries]
    measured = {
        which: measure_negative_queries(scene.index, scene.texts, negative_nouns(known, which))
        for which in get_args(NounList)
    }
    nouns = measured["nouns"]
    if nouns is None:
        return Skipped("no test view shows a label")
    details = {_DETAILS[which]: asdict(figures) for which, figures in measured.items() if figures is not None}
    return SceneFigure(nouns.auroc, details=details)


_DETAILS = {"nouns": "absent", "household": "absent_household"}

ABSENT_AUROC = SceneMetric(
    name="absent_auroc",
    unit="",
    higher_is_better=True,
    description="AUROC of the answers' presence, of the data set's own label names against nouns of things that are "
    "not there; a scene that has a label answers to its name with certainty, so 1 is expected whenever it has them "
    "all, and says nothing about other words for the same things",
    measure=measure_absent_auroc,
    parameters={"recall_of_false_positives": RECALL},
    headline=True,
)


@cache
def _nouns(which: NounList) -> tuple[str, ...]:
    file = Path(__file__).with_name(f"negative_{which}.txt")
    return tuple(line.strip() for line in file.read_text(encoding="utf-8").splitlines() if line.strip())
