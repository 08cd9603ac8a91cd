"""The sentence of an answer, identical in every interface."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.language.sentences.enclosures import may_hold
from fastsplat.service.query.language.words.english import NoQuestion
from fastsplat.service.query.language.words.judgement import Ranked, Remarks
from fastsplat.service.query.language.words.noun_phrases import noun_phrase
from fastsplat.service.query.objects.absence import RATHER, Hollow, UnseenSpace
from fastsplat.service.query.objects.names.object_names import ObjectNames
from fastsplat_contract.messages.phrases import PhraseAnswer, RefusalReason
from fastsplat_contract.messages.queries import Answer, Outcome, Relation, RelationSubject

MOST_NAMED = 3
"""Objects and names listed in a sentence; the others are counted."""
_MAX_QUOTED = 60
InWords = Callable[[Sequence[int]], str]
"""Describes objects, see `ObjectWords.listed`."""

_OPENINGS: Mapping[Outcome, str] = {
    "here": "Here",
    "probably_here": "Probably here",
    "not_here": "Not here",
    "not_seen": "Not seen",
    "cannot_say": "Cannot say",
}
_RELATIONS: Mapping[tuple[Relation, RelationSubject | None], str] = {
    ("kind_of", "label"): "a kind of {text}",
    ("kind_of", "question"): "the closest to {text}, which is a kind of it",
    ("part_of", "label"): "a part of {text}",
    ("part_of", "question"): "of which {text} is a part",
    ("related", None): "related to {text}",
}
_NO_QUESTIONS: Mapping[NoQuestion, str] = {
    "empty": "{text} names nothing that could be looked for; name an object",
    "foreign": "only English is understood, and {text} is of another language; no name in this scene is written so",
    "unknown": "{text} is a name that nobody gave here; name what it is",
}
_REFUSALS: Mapping[RefusalReason, str] = {
    "not_understood": "{part} was not understood",
    "ambiguous": "{part} can be read in several ways, with different answers",
    "pose_needed": "{part} depends on where you stand",
    "vertical_unknown": "{part} needs to know what is up, and the scene does not tell",
    "too_close": "{part} is too close to call",
    "out_of_view": "{part} is of what the asker faces, and some of it is behind or too near",
    "indirect": "it rests on something else, and only that is {part}",
    "ambiguous_referent": "several objects here may be meant in {part}, with different answers",
    "referent_absent": "no {part} is here",
    "nothing_to_compare": "there is only one, so nothing says whether it is {part}",
    "not_measured": "nothing here measures {part}",
    "not_named": "nothing here is named {part}",
    "not_read": "no photo was read to show {part}",
}
_CHOICES: Mapping[RefusalReason, str] = {
    "ambiguous": "say it in another way",
    "pose_needed": "send the asker's pose",
    "vertical_unknown": "align the scene",
    "out_of_view": "ask from another place",
    "ambiguous_referent": "say which",
    "not_named": "name it",
}
"""Hints that make a phrase decidable."""


def quoted(text: str) -> str:
    """Quotes a text, shortened."""
    return f'"{text}"' if len(text) <= _MAX_QUOTED else f'"{text[: _MAX_QUOTED - 1]}…"'


def enumerated(items: Sequence[str], more: int = 0, joint: str = "and") -> str:
    """Joins items as 'A, B and C'; with `more`, "and 2 more" is added."""
    every = [*items, f"{more} more"] if more else list(items)
    return every[0] if len(every) == 1 else f"{', '.join(every[:-1])} {joint} {every[-1]}"


def outcome_of(ranked: Ranked, not_seen: bool) -> Outcome:
    """Outcome of a ranking; never "not here" for what may be hidden."""
    answer, verdict = ranked.answer, ranked.verdict
    if verdict == "absent":
        return "not_seen" if not_seen else "not_here"
    if verdict == "undecided":
        return "cannot_say"
    meant = (answer.relation, answer.relation_subject) in (("same", None), ("kind_of", "label"))
    sure = answer.probability is None or answer.probability >= RATHER
    if verdict == "exact" or (verdict == "related" and meant and sure):
        return "here"
    return "probably_here"


def spoken(ranked: Ranked, names: ObjectNames, unseen: UnseenSpace, in_words: InWords) -> Answer:
    """Adds outcome and sentence to an answer."""
    answer, remarks = replace(ranked.answer, noun_phrase=ranked.noun_phrase), ranked.remarks
    of_conditions = answer.phrase is not None and not remarks.head
    held = () if of_conditions else may_hold(unseen, answer.noun_phrase, names.taken_for)
    closest = ""
    if remarks.other_object:
        closest = f"; the closest is {_belonging(answer.relevant_ids[:1], _labels(answer), names, in_words)}"
        matches = tuple(match._replace(relevant=False) for match in answer.matches)
        answer = replace(answer, relation="absent", probability=None, presence=None, object_ids=(), matches=matches)
        ranked = replace(ranked, answer=answer, verdict="absent")
    outcome = outcome_of(ranked, unseen.hides or bool(held))
    if outcome == "not_seen":
        answer = replace(answer, probability=None)
    if outcome == "cannot_say":
        said = f"Cannot say{_unsaid(answer, remarks, names, in_words)}."
    else:
        if outcome in ("not_here", "not_seen"):
            hidden = f"; {_hidden(unseen, held, names, in_words)}" if outcome == "not_seen" else ""
            what = _missing(answer, remarks, names, in_words) + closest + hidden
        elif answer.phrase is not None:
            what = _decided(answer, answer.phrase, remarks, names, in_words)
        else:
            what = _found(ranked, names, in_words)
        rather_not = outcome == "probably_here" and answer.probability is not None and answer.probability < RATHER
        said = f"{'Perhaps here' if rather_not else _OPENINGS[outcome]}{percent(answer.probability)}: {what}."
    return replace(answer, outcome=outcome, sentence=said)


def percent(probability: float | None) -> str:
    """Formats a probability as " (19 %)"; "" if unmeasured or certain."""
    if probability is None or probability == 1.0:
        return ""
    return f" ({min(max(round(100 * probability), 1), 99)} %)" if probability else " (0 %)"


def doubt_of(answer: Answer, names: ObjectNames) -> str:
    """Explains the doubt about the name in a probable answer."""
    match = answer.matches[0]
    return f"that it is {quoted(match.label)} is {'not sure' if names.is_borne(match.label_id) else 'only suggested'}"


def _found(ranked: Ranked, names: ObjectNames, in_words: InWords) -> str:
    """Phrase for what answers a name or a description."""
    answer, verdict, remarks = ranked.answer, ranked.verdict, ranked.remarks
    question = quoted(noun_phrase(answer.text))
    if remarks.by_shape:
        taken = "" if verdict == "exact" else f", taken for {question}"
        return f"{in_words(answer.object_ids)}{taken}, by shape and place"
    if remarks.by_looks:
        return f"{in_words(answer.object_ids)}, taken for {question}, by its looks"
    ids = answer.relevant_ids
    labels = _labels(answer)
    remark = f"; {quoted(remarks.unchecked)} was not checked" if remarks.unchecked else ""
    if answer.relation == "same":
        relation = f", the same as {question}" if not ranked.named else ""
    else:
        relation = f", {_RELATIONS[answer.relation, answer.relation_subject].format(text=question)}"
    if verdict == "possible" and not any(map(names.is_borne, ids)):
        may_be = enumerated([quoted(label) for label in labels.values()][:MOST_NAMED], joint="or")
        said_names = [names.table[label_id] for label_id in ids if label_id in names.table]
        sources = sorted({source for name in said_names for source in name.sources})
        said_by = f", say{'' if sources[1:] else 's'} {enumerated(list(map(quoted, sources)))}" if sources else ""
        return f"{in_words(answer.object_ids)} may be {may_be}{said_by}{relation}{remark}"
    if verdict in ("exact", "possible"):
        doubt = "" if verdict == "exact" else ", but that name is not sure"
        return f"{_belonging(ids, labels, names, in_words)}{relation}{doubt}{remark}"
    first = _belonging(ids[:1], labels, names, in_words)
    then = f"; then {_belonging(ids[1:], labels, names, in_words)}" if ids[1:] else ""
    return f"{first}{relation}{then}{remark}"


def _labels(answer: Answer) -> Mapping[int, str]:
    return {match.label_id: match.label for match in answer.matches if match.relevant}


def _belonging(label_ids: Sequence[int], labels: Mapping[int, str], names: ObjectNames, in_words: InWords) -> str:
    """Describes the objects of some names, or the names if labels are not of objects."""
    if all(label_id in names.by_label for label_id in label_ids):
        return in_words(names.of_labels(label_ids))
    quotes = [quoted(labels[label_id]) for label_id in label_ids]
    return enumerated(quotes[:MOST_NAMED], max(0, len(quotes) - MOST_NAMED))


def _decided(answer: Answer, phrase: PhraseAnswer, remarks: Remarks, names: ObjectNames, in_words: InWords) -> str:
    """Describes the objects that a phrase means."""
    objects = in_words(answer.object_ids)
    count = f"{phrase.count} ({objects})" if phrase.count is not None else objects
    keys = {label_key(names.called.get(object_id, "")) for object_id in answer.object_ids}
    head = f" for {quoted(phrase.head)}" if phrase.head and keys - {label_key(phrase.head)} else ""
    return ", ".join((f"{count}{head}", *phrase.conditions)) + _left_open(phrase, remarks, in_words)


def _missing(answer: Answer, remarks: Remarks, names: ObjectNames, in_words: InWords) -> str:
    """Phrase for what is not here."""
    if answer.phrase is not None and not remarks.head:
        return f"nothing is {_question_text(answer.phrase)}{_left_open(answer.phrase, remarks, in_words)}"
    only = "" if remarks.calibrated else "; the text encoder is not calibrated for these prompts, so only names count"
    count, text = len(names.table), answer.noun_phrase
    searched = {0: "nothing in this scene has a name", 1: f"the one name in this scene is not {quoted(text)}"}
    none = searched.get(count, f"none of the {count} names in this scene is {quoted(text)}")
    if count and names.dictionary.id_of(text):
        none = f"nothing bears the name {quoted(text)}"
    unnamed = answer.searched.unnamed_objects
    said = f"; {unnamed} {'object has' if unnamed == 1 else 'objects have'} no name" if unnamed else ""
    return f"{none}{said}{only}"


def _hidden(unseen: UnseenSpace, held: Sequence[Hollow], names: ObjectNames, in_words: InWords) -> str:
    """Phrase for where it may be hidden."""
    called = names.called if names.stored else names.taken_for
    said = []
    if unseen.hides:
        behind = list(dict.fromkeys(quoted(name) for object_id in unseen.behind if (name := called.get(object_id))))
        where = f", most of it behind or in {enumerated(behind)}" if behind else ""
        said.append(f"no photo shows {round(100 * unseen.share)} % of the place{where}")
    if held:
        first = held[0]
        inside = in_words([first.object_id]) if names.stored else quoted(called[first.object_id])
        volume = f" ({first.volume:.1g} m³)" if unseen.in_meters else ""
        more = f", and into {len(held) - 1} more" if held[1:] else ""
        view = f"; look into it, from where {first.view} was taken" if first.view else ""
        said.append(f"no photo looks into {inside}{volume}{more}{view}")
    return ", and ".join(said)


def _unsaid(answer: Answer, remarks: Remarks, names: ObjectNames, in_words: InWords) -> str:
    """Phrase for why it cannot be said, and what would help."""
    question, phrase = quoted(noun_phrase(answer.text)), answer.phrase
    if remarks.no_question:
        return f": {_NO_QUESTIONS[remarks.no_question].format(text=question)}"
    if phrase is not None and phrase.refusal is not None:
        reason = _REFUSALS[phrase.refusal.reason].format(part=quoted(phrase.refusal.part))
        understood = ""
        if phrase.refusal.reason == "not_understood" and (phrase.head or phrase.conditions):
            understood = f"; understood was {_question_text(phrase)}"
        may_be = f"; it may be {in_words(answer.object_ids)}" if answer.object_ids else ""
        choice = _CHOICES.get(phrase.refusal.reason, "")
        return f": {reason}{understood}{may_be}" + (f"; {choice}" if choice else "")
    unnamed, text = answer.searched.unnamed_objects, answer.noun_phrase
    if not unnamed:
        return f" whether {quoted(text)} is here: something here may be it, and no name says so; ask by another word"
    have = "one object has no name" if unnamed == 1 else f"{unnamed} objects have no name"
    none = "nothing bears that name" if names.dictionary.id_of(text) else "no name here is it"
    named = "no object here has a name yet" if not names.table else f"{none}, and {have}"
    count = len(answer.object_ids)
    may_be = f"; {'one object' if count == 1 else f'{count} objects'} may be it" if count else ""
    return f" whether {quoted(text)} is here: {named}{may_be}; name what it is"


def _left_open(phrase: PhraseAnswer, remarks: Remarks, in_words: InWords) -> str:
    undecided = f"; undecided: {in_words(phrase.undecided)}" if phrase.undecided else ""
    return undecided + (f"; {remarks.doubt}" if remarks.doubt else "")


def _question_text(phrase: PhraseAnswer) -> str:
    head = [quoted(phrase.head)] if phrase.head else []
    return ", ".join([*head, *phrase.conditions]) or "anything"
