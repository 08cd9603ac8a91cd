"""One sentence for people about a question that says more than a name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from fastsplat_contract.phrase_messages import PhraseAnswer, RefusalReason

_MAX_NAMES = 10
_MAX_QUOTED = 60

_REASONS: Mapping[RefusalReason, str] = {
    "not_understood": "{part} was not understood",
    "ambiguous": "{part} can be read in several ways, with different answers",
    "pose_needed": "{part} depends on where you stand: send the asker's pose",
    "vertical_unknown": "{part} needs to know what is up, and the scene does not tell",
    "too_close": "{part} is too close to call",
    "out_of_view": "{part} is of what the asker faces, and some of it is behind or too near",
    "indirect": "it rests on something else, and only that is {part}",
    "ambiguous_referent": "several things here may be meant in {part}, with different answers",
    "referent_absent": "no {part} is here",
    "nothing_to_compare": "there is only one, so nothing says whether it is {part}",
    "not_measured": "nothing here measures {part}",
    "not_named": "nothing here is named {part}",
}


def phrase_sentence(
    answer: PhraseAnswer, called: Mapping[int, str], taken: str = "", may_be: Sequence[int] = ()
) -> str:
    """What was decided, or why it could not be; by which measurements, its witnesses say.

    Args:
        answer: complete.
        called: the names of things, by id; "" for none.
        taken: what was taken for something that the question calls, where that is not sure; "" without.
        may_be: things that may be meant where nothing was decided.
    """
    if answer.refusal is not None:
        why = _REASONS[answer.refusal.reason].format(part=_quoted(answer.refusal.part))
        understood = ""
        if answer.refusal.reason == "not_understood" and (answer.head or answer.conditions):
            understood = f"; understood was {_asked(answer)}"
        shown = f"; it may be {_names(may_be, called)}" if may_be else ""
        return f"It cannot be decided, because {why}{understood}{shown}."
    doubt = f"; {taken[:1].lower()}{taken[1:].rstrip('.')}" if taken else ""
    undecided = f"; undecided: {_names(answer.undecided, called)}" if answer.undecided else ""
    if not answer.things:
        return f"Nothing here is {_asked(answer)}{undecided}{doubt}."
    if answer.asks == "count":
        return f"{len(answer.things)} here: {_asked(answer)}{undecided}{doubt}."
    asked = _asked(answer)
    return f"{asked[:1].upper()}{asked[1:]}: {_names(answer.things, called)}{undecided}{doubt}."


def surface_sentence(noun: str, count: int, *, sure: bool) -> str:
    """That surfaces without a name are what a noun calls, by their shape and place."""
    surfaces = "A surface without a name is" if count == 1 else f"{count} surfaces without a name are"
    return f"{surfaces} {'' if sure else 'taken for '}{_quoted(noun)}, by shape and place."


def _asked(answer: PhraseAnswer) -> str:
    head = [_quoted(answer.head)] if answer.head else []
    return ", ".join([*head, *answer.conditions]) or "anything"


def _names(ids: Sequence[int], called: Mapping[int, str]) -> str:
    """ "apple", 2 of "orange", and 3 things without a name."""
    counted = Counter(called.get(each, "") for each in ids)
    nameless = counted.pop("", 0)
    names = [_quoted(name) if count == 1 else f"{count} of {_quoted(name)}" for name, count in counted.items()]
    if len(names) > _MAX_NAMES:
        names = [*names[:_MAX_NAMES], f"{len(names) - _MAX_NAMES} more names"]
    if nameless:
        names.append("a thing without a name" if nameless == 1 else f"{nameless} things without a name")
    return ", ".join(names)


def _quoted(text: str) -> str:
    return f'"{text}"' if len(text) <= _MAX_QUOTED else f'"{text[: _MAX_QUOTED - 1]}…"'
