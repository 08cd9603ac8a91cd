"""One sentence for people; the figures behind it are in the answer's fields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fastsplat_contract.queries import Answer, Relation, RelationSubject, Searched

_MAX_LABELS = 3
_MAX_QUOTED = 60

_RELATIONS: Mapping[tuple[Relation, RelationSubject | None], str] = {
    ("same", None): "The scene has {label}, which is the same as {text}",
    ("kind_of", "label"): "The scene has {label}, a kind of {text}",
    ("kind_of", "question"): "Closest match: {label}, of which {text} is a kind",
    ("part_of", "label"): "Closest match: {label}, a part of {text}",
    ("part_of", "question"): "Closest match: {label}, of which {text} is a part",
    ("related", None): "Closest match: {label}, related to {text}",
}
"""How a sentence says a relation."""


def explain(answer: Answer, unchecked: str = "", may_be: int = 0, language: str = "") -> str:
    """A sentence that says which entries answer and how probable that is.

    Args:
        answer: complete but for the explanation.
        unchecked: words of the question that no entry answers for, see `NameMatch.unchecked`.
        may_be: how many things without a name the answer is about, because its name is suggested for them.
        language: "empty", "foreign" or "unknown" for a text that is no question in English.
    """
    question = _quoted(answer.text)
    if language == "empty":
        return f"{question} names nothing that could be looked for."
    if language:
        what = "is of another language" if language == "foreign" else "is no word that is known here"
        return f"Only English is understood, and {question} {what}; no name in this scene is written so."
    if answer.verdict == "undecided":
        return f"It cannot be said whether {question} is here{_because(answer)}."
    percent = "" if answer.probability in (None, 1.0) else f" ({_percent(answer.probability or 0.0)})"
    labels = [match.label for match in answer.matches if match.relevant]
    if answer.verdict == "possible":
        kind = f", a kind of {question}" if answer.relation == "kind_of" else ""
        label = _quoted(labels[0]) if labels else question
        if not may_be:
            return f"{label} may be here{kind}{percent}: a thing is named so, and the name is not sure."
        things = "a thing without a name" if may_be == 1 else f"{may_be} things without a name"
        return f"{label} may be here{kind}{percent}: it is suggested for {things}."
    if not answer.matches:
        return f"This scene has no labels, so {question} cannot be found{_unnamed(answer.searched)}."
    best = answer.matches[0]
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
            f"count (nearest: {_quoted(best.label)}){_unnamed(answer.searched)}."
        )
    if answer.searched.named_things is not None:
        things = _count(answer.searched.named_things, "named thing")
        return f"{question} is not among {things}{percent}{_unnamed(answer.searched)}."
    return f"No label matches {question}{percent}; the nearest is {_quoted(best.label)}{_unnamed(answer.searched)}."


def _because(answer: Answer) -> str:
    """Why it cannot be said."""
    named, unnamed = answer.searched.named_things, answer.searched.unnamed_things
    if unnamed and not named:
        return ": no thing in this scene has a name yet"
    if unnamed:
        have = "has no name" if unnamed == 1 else "have no name"
        return f": it is not among {_count(named or 0, 'named thing')}, and {unnamed} {have}"
    return f"; the nearest is {_quoted(answer.matches[0].label)}" if answer.matches else ""


def _unnamed(searched: Searched) -> str:
    """ "; 5 have no name", where things have none."""
    count = searched.unnamed_things
    return f"; {count} {'has' if count == 1 else 'have'} no name" if count else ""


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
