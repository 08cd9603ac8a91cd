"""One sentence for people; the figures behind it are in the answer's fields."""

from __future__ import annotations

from collections.abc import Sequence

from fastsplat_contract.queries import Answer

_MAX_LABELS = 3
_MAX_QUOTED = 60


def explain(answer: Answer, unchecked: str = "") -> str:
    """A sentence that says which entries answer and how probable that is.

    Args:
        answer: complete but for the explanation.
        unchecked: words of the question that no entry answers for, see `NameMatch.unchecked`.
    """
    question = _quoted(answer.text)
    if not answer.matches:
        return f"This scene has no labels, so {question} cannot be found."
    best = answer.matches[0]
    percent = "" if answer.probability in (None, 1.0) else f" ({_percent(answer.probability or 0.0)})"
    labels = [match.label for match in answer.matches if match.relevant]
    remark = f"; {_quoted(unchecked)} was not checked" if unchecked else ""
    if answer.verdict == "related":
        return f"Closest match: {_quoted(labels[0])}{percent}{_enumerated(labels[1:], ', then ')}{remark}."
    if answer.verdict == "exact":
        remark = ("" if best.gaussian_count else ", but no Gaussian carries this label") + remark
        names = _enumerated(labels)
        if answer.decided_by == "name":
            return f"The scene has {names}{percent}{remark}."
        return f"{question} is labeled {names} in this scene{percent}{remark}."
    if answer.threshold is None:
        return (
            f"No label is named {question}; the text encoder is not calibrated for these prompts, so that only names "
            f"count (nearest: {_quoted(best.label)})."
        )
    return f"No label matches {question}{percent}; the nearest is {_quoted(best.label)}."


def _enumerated(labels: Sequence[str], before: str = "") -> str:
    """'"cup", "mug", "jar" and 2 more', after `before`; "" of no labels."""
    if not labels:
        return ""
    more = f" and {len(labels) - _MAX_LABELS} more" if len(labels) > _MAX_LABELS else ""
    return before + ", ".join(map(_quoted, labels[:_MAX_LABELS])) + more


def _quoted(text: str) -> str:
    return f'"{text}"' if len(text) <= _MAX_QUOTED else f'"{text[: _MAX_QUOTED - 1]}…"'


def _percent(probability: float) -> str:
    return f"{min(max(round(100 * probability), 1), 99)} %" if 0 < probability < 1 else f"{100 * probability:.0f} %"
