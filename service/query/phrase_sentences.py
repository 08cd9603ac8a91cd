"""One sentence for people about a question that says more than a name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fastsplat_contract.phrase_messages import PhraseAnswer, RefusalReason, Witness

_MAX_IDS = 10
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


def phrase_sentence(answer: PhraseAnswer, rest: str) -> str:
    """What was decided, by which measurement, or why it could not be.

    Args:
        answer: complete.
        rest: the sentence about the text as a name, which follows where nothing was decided.
    """
    if answer.refusal is not None:
        why = _REASONS[answer.refusal.reason].format(part=_quoted(answer.refusal.part))
        understood = ""
        if answer.refusal.reason == "not_understood" and (answer.head or answer.conditions):
            understood = f"; understood was {_asked(answer)}"
        return f"It cannot be decided, because {why}{understood}. {rest}".strip()
    undecided = f"; undecided: {_ids(answer.undecided)}" if answer.undecided else ""
    if not answer.things:
        return f"Nothing here is {_asked(answer)}{_by(answer.witnesses, -1)}{undecided}."
    by = _by([witness for witness in answer.witnesses if witness.thing == answer.things[0]], 1)
    if answer.asks == "count":
        return f"{len(answer.things)} here: {_asked(answer)}: {_ids(answer.things)}{by}{undecided}."
    return f"{_asked(answer)[:1].upper()}{_asked(answer)[1:]}: {_ids(answer.things)}{by}{undecided}."


def _asked(answer: PhraseAnswer) -> str:
    head = _quoted(answer.head) if answer.head else "anything"
    return ", ".join([head, *answer.conditions])


def _by(witnesses: Sequence[Witness], sign: int) -> str:
    """The least clear of the measurements that decided."""
    decided = [witness for witness in witnesses if witness.clearness * sign >= 1]
    if not decided:
        return ""
    witness = min(decided, key=lambda each: abs(each.clearness))
    of = f" of thing {witness.thing}" if sign < 0 else ""
    to = f" to {_ids(witness.others)}" if witness.others else ""
    unit = {"delta_e": " ΔE", "share": "", "ratio": "", "unit": " units", "deg": "°"}.get(
        witness.unit, f" {witness.unit}"
    )
    return f" ({witness.measure.replace('_', ' ')}{of}{to}: {witness.value:.3g}{unit.rstrip()})"


def _ids(ids: Sequence[int]) -> str:
    more = f" and {len(ids) - _MAX_IDS} more" if len(ids) > _MAX_IDS else ""
    return ("thing " if len(ids) == 1 else "things ") + ", ".join(map(str, ids[:_MAX_IDS])) + more


def _quoted(text: str) -> str:
    return f'"{text}"' if len(text) <= _MAX_QUOTED else f'"{text[: _MAX_QUOTED - 1]}…"'
