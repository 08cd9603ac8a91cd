"""One sentence that says why."""

from __future__ import annotations

from dataclasses import replace

from fastsplat.service.query.calibration import Score
from fastsplat_contract.queries import Answer, Match

_SHOWN = 3
_MAX_QUOTED = 60


def explain(answer: Answer, score: Score) -> Answer:
    """The answer with its explanation, for people: which entry, by what score against which threshold, how likely, and
    for LERF's relevancy against which canonical negative.

    Args:
        answer: complete but for the explanation.
        score: what its thresholds are held against.
    """
    return replace(answer, explanation=_sentence(answer, score))


def _sentence(answer: Answer, score: Score) -> str:
    text = answer.text
    asked = text if len(text) <= _MAX_QUOTED else text[: _MAX_QUOTED - 1] + "…"
    if not answer.matches:
        return f'No "{asked}" here: this scene has no labels.'
    chosen = [match for match in answer.matches if match.relevant]
    shown = ", then ".join(f'"{match.label}"' for match in chosen[:_SHOWN])
    more = f" and {len(chosen) - _SHOWN} more" if len(chosen) > _SHOWN else ""
    best = answer.matches[0]
    likely = "" if answer.probability is None else f", {_percent(answer.probability)} likely"
    if answer.verdict == "exact":
        missing = "" if best.gaussian_count else ", but no Gaussian of it remains"
        if answer.decided_by == "name":
            return f'The scene has "{best.label}"{missing}.'
        return f'"{asked}" goes by {shown}{more} here ({_why(best, score, answer.threshold, "≥")}{likely}){missing}.'
    if answer.verdict == "related":
        return f'No "{asked}" here; the closest is {shown}{more} ({_why(best, score, answer.threshold, "≥")}{likely}).'
    if answer.threshold is None:
        return (
            f'No entry is named "{asked}". This text encoder is not calibrated for these prompts, so only names count; '
            f'the nearest entry is "{best.label}" (similarity {best.similarity:.2f}).'
        )
    return (
        f'Nothing like "{asked}" is here{likely}; even "{best.label}" is far '
        f"({_why(best, score, answer.threshold, '<')})."
    )


def _why(best: Match, score: Score, threshold: float | None, sign: str) -> str:
    """The score and what it was held against; LERF's threshold counts in the margin, where 0 is a relevancy of 0.5."""
    held = "" if threshold is None else f" {sign} {threshold:.2f}"
    if score == "similarity":
        return f'similarity {best.similarity:.2f}{held}, nearest negative "{best.nearest_negative}"'
    margin = "" if threshold is None else f", margin{held}"
    return f'relevancy {best.relevancy:.2f} against "{best.nearest_negative}"{margin}'


def _percent(probability: float) -> str:
    return f"{min(max(round(100 * probability), 1), 99)} %" if 0 < probability < 1 else f"{probability:.0%}"
