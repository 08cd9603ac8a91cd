"""Whether a scene knows what is not in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fastsplat.service.evaluation.detection import auroc, false_positive_rate_at
from fastsplat.service.query import SceneIndex
from fastsplat_contract.queries import Answer

RECALL = 0.95


@dataclass(frozen=True)
class Absence:
    """Texts for what is there against texts for what is not.

    Attributes:
        auroc: of the answers' presence, see `presence_scores`.
        false_positives: share of absent texts that pass the threshold which 95 % of the present ones pass.
        said_absent: share of absent texts whose verdict is `absent`.
        said_present: share of present texts whose verdict is not.
        texts: how many absent texts were asked.
        worst: the absent texts that look most present, at most ten.
    """

    auroc: float
    false_positives: float
    said_absent: float
    said_present: float
    texts: int
    worst: tuple[str, ...]


def measure_absence(index: SceneIndex, present: Sequence[str], absent: Sequence[str]) -> Absence | None:
    """None when there is nothing to ask on one of the sides."""
    if not present or not absent:
        return None
    answers = ask_all(index, [*present, *absent])
    here, gone = answers[: len(present)], answers[len(present) :]
    scores = presence_scores(answers)
    high, low = scores[: len(present)], scores[len(present) :]
    worst = sorted(zip(low, absent, strict=True), reverse=True)[:10]
    return Absence(
        auroc=auroc(high, low),
        false_positives=false_positive_rate_at(RECALL, high, low),
        said_absent=sum(answer.verdict == "absent" for answer in gone) / len(gone),
        said_present=sum(answer.verdict != "absent" for answer in here) / len(here),
        texts=len(gone),
        worst=tuple(text for _, text in worst),
    )


def presence_scores(answers: Sequence[Answer]) -> list[float]:
    """How likely each answer holds it that the thing is there: its calibrated presence, or, where the encoder was not
    calibrated, the similarity of the entry that is most alike."""
    calibrated = [answer.presence for answer in answers if answer.presence is not None]
    if len(calibrated) == len(answers):
        return calibrated
    return [max((match.similarity for match in answer.matches), default=-1.0) for answer in answers]


def ask_all(index: SceneIndex, texts: Sequence[str]) -> list[Answer]:
    """Answers to any number of texts, in order."""
    step = index.settings.max_texts
    return [answer for start in range(0, len(texts), step) for answer in index.ask(texts[start : start + step])]
