"""One sentence for people; the figures behind it are in the answer's fields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fastsplat_contract.queries import Answer, Relation, RelationSubject, Searched

_MAX_LABELS = 3
_MAX_QUOTED = 60
_MAX_IDS = 10

_RELATIONS: Mapping[tuple[Relation, RelationSubject | None], str] = {
    ("same", None): "The scene has {label}, which is the same as {text}",
    ("kind_of", "label"): "The scene has {label}, a kind of {text}",
    ("kind_of", "question"): "Closest match: {label}, of which {text} is a kind",
    ("part_of", "label"): "Closest match: {label}, a part of {text}",
    ("part_of", "question"): "Closest match: {label}, of which {text} is a part",
    ("related", None): "Closest match: {label}, related to {text}",
}
"""How a sentence says a relation."""


def explain(answer: Answer, unchecked: str = "", may_be: Sequence[int] = (), suggested: float = 0.0) -> str:
    """A sentence that says which entries answer and how probable that is.

    Args:
        answer: complete but for the explanation.
        unchecked: words of the question that no entry answers for, see `NameMatch.unchecked`.
        may_be: things without a name for which the text is suggested.
        suggested: the largest probability of these suggestions.
    """
    question = _quoted(answer.text)
    if not answer.matches:
        return (
            f"This scene has no labels, so {question} cannot be found{_looked_for(answer.searched, may_be, suggested)}."
        )
    best = answer.matches[0]
    percent = "" if answer.probability in (None, 1.0) else f" ({_percent(answer.probability or 0.0)})"
    labels = [match.label for match in answer.matches if match.relevant]
    remark = f"; {_quoted(unchecked)} was not checked" if unchecked else ""
    if answer.method == "lexicon" and answer.decided_by == "score" and answer.verdict != "absent":
        relation = _RELATIONS[answer.relation, answer.relation_subject].format(label=_quoted(labels[0]), text=question)
        return f"{relation}{percent}{_enumerated(labels[1:], ', then ')}{remark}."
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
            f"count (nearest: {_quoted(best.label)}){_looked_for(answer.searched, may_be, suggested)}."
        )
    looked_for = _looked_for(answer.searched, may_be, suggested)
    if answer.searched.named_things is not None:
        things = _count(answer.searched.named_things, "named thing")
        return f"{question} is not among {things}{percent}{looked_for}; the nearest is {_quoted(best.label)}."
    return f"No label matches {question}{percent}; the nearest is {_quoted(best.label)}{looked_for}."


def _looked_for(searched: Searched, may_be: Sequence[int], suggested: float) -> str:
    """ "; 5 have no name (3, 7, 8 and 2 more); this scene was searched for 80 names", as far as it is known."""
    text = ""
    if searched.unnamed_things:
        text += f"; {searched.unnamed_things} have no name ({_ids(searched.unnamed, searched.unnamed_things)})"
    if may_be:
        text += f"; it may be thing {_ids(may_be, len(may_be))} ({_percent(suggested)})"
    if searched.names is not None:
        text += f"; this scene was searched for {_count(searched.names, 'name')}"
    return text


def _ids(ids: Sequence[int], count: int) -> str:
    more = f" and {count - _MAX_IDS} more" if count > _MAX_IDS else ""
    return ", ".join(map(str, ids[:_MAX_IDS])) + more


def _count(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")


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
