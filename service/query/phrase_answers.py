"""Answers to questions that say more than a name: "the red mug left of the lamp", "how many cups are on the table?"."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from fastsplat.service.query.name_matching import NameIndex
from fastsplat.service.query.phrase_sentences import phrase_sentence
from fastsplat.service.query.phrase_solving import Named, PhraseSolver, Solved
from fastsplat.service.query.phrases import ParsedQuestion, Phrase, Possession
from fastsplat.service.query.relations import F64, asker_at
from fastsplat.service.query.thing_measures import ThingMeasures
from fastsplat.service.query.thing_names import ThingNames
from fastsplat_contract.phrase_messages import PhraseAnswer, Refusal
from fastsplat_contract.queries import Answer

Rank = Callable[[Sequence[str]], Sequence[Answer]]
"""The answers to some texts, each as if it were a name."""


@dataclass(frozen=True)
class AskedScene:
    """What phrases ask of a scene.

    Attributes:
        things: by their names.
        names: of the dictionary.
        rank: answers noun groups.
        open_measures: gives the measures of the things; called only where something must be measured.
        unit: of lengths: "m" or "unit".
    """

    things: ThingNames
    names: NameIndex
    rank: Rank
    open_measures: Callable[[], ThingMeasures]
    unit: str


def answer_phrase(question: ParsedQuestion, plain: Answer, scene: AskedScene, world_from_camera: F64 | None) -> Answer:
    """The answer to one such text.

    Args:
        question: what it says.
        plain: the answer to it as if it were a name, which stays where nothing can be decided.
        scene: whom it is asked of.
        world_from_camera: float64 [4, 4] where the asker stands, OpenCV axes; None if nobody said that.
    """
    things = scene.things
    groups = sorted({name for reading in question.readings for name in _names_in(reading)})
    answers = dict(zip(groups, scene.rank(groups), strict=True)) if groups else {}
    named = {name: _named(name, answer, things, scene.names) for name, answer in answers.items()}
    named[""] = Named(tuple(thing.id for thing in things.present if not thing.surface), by_name=True)
    asker = None
    if world_from_camera is not None:
        measures = scene.open_measures()
        asker = asker_at(world_from_camera, measures.axes, measures.up is not None)
    by_id = {thing.id: thing for thing in (*things.present, *things.parts)}
    solver = PhraseSolver(scene.open_measures, by_id, named, asker, scene.unit)
    solved = _agreed([solver.solve(reading) for reading in question.readings], question)
    reading = question.readings[0]
    refusal = solved.refusal
    if question.not_understood:
        refusal = Refusal("not_understood", question.not_understood)
    elif refusal is None and question.asks == "count" and solved.undecided:
        refusal = next(iter(solved.undecided.values()))
    elif refusal is None and not solved.things and not solved.named.by_name:
        refusal = Refusal("not_named", reading.head)
    phrase = PhraseAnswer(
        asks=question.asks,
        head=reading.head,
        conditions=reading.said,
        not_understood=question.not_understood,
        things=solved.things,
        undecided=tuple(solved.undecided),
        witnesses=solved.witnesses,
        count=len(solved.things) if question.asks == "count" and refusal is None else None,
        refusal=refusal,
    )
    if refusal is not None:
        return replace(plain, phrase=phrase, explanation=phrase_sentence(phrase, plain.explanation))
    head = answers.get(reading.group if solved.named.whole else reading.head, plain)
    return _decided(replace(head, text=plain.text, phrase=phrase), things, anything=not reading.head)


def _names_in(phrase: Phrase) -> set[str]:
    """The noun groups of a phrase and of all that it speaks of."""
    inner = [] if phrase.rank is None else [*phrase.rank.anchors]
    for condition in phrase.conditions:
        inner += [condition.phrase] if isinstance(condition, Possession) else condition.anchors
    names = {phrase.head, phrase.group} if phrase.head else set[str]()
    return names.union(*map(_names_in, inner))


def _named(name: str, answer: Answer, things: ThingNames, names: NameIndex) -> Named:
    match = names.match(name)
    ids = [thing_id for label_id in answer.relevant_ids for thing_id in things.by_label.get(label_id, ())]
    return Named(
        tuple(dict.fromkeys(ids)) if answer.verdict != "absent" else (),
        by_name=answer.decided_by == "name",
        whole=answer.verdict == "exact" and bool(match.exact) and not match.unchecked,
    )


def _agreed(readings: Sequence[Solved], question: ParsedQuestion) -> Solved:
    """The one that all readings come to. A reading that speaks of something that is not here, or for which nothing is
    left while another has something, is not what was meant."""
    first = readings[0]
    sensible = [each for each in readings if each.refusal is None or each.refusal.reason != "referent_absent"]
    some = [each for each in sensible if each.things or each.refusal is not None or question.asks == "count"]
    meant = some or sensible or [first]
    outcomes = {(each.things, frozenset(each.undecided), each.refusal) for each in meant}
    if len(outcomes) == 1:
        return meant[0]
    part = " ".join(question.readings[0].said)
    return replace(first, things=(), undecided={}, refusal=Refusal("ambiguous", part))


def _decided(answer: Answer, things: ThingNames, anything: bool) -> Answer:
    """The answer for the things that were decided on, with the entries of their names first. How probable that is,
    nobody has measured, where no name says it."""
    assert answer.phrase is not None
    ids = answer.phrase.things
    bearing = {label_id for label_id, own in things.by_label.items() if set(own) & set(ids)}
    matches = tuple(match._replace(relevant=match.label_id in bearing) for match in answer.matches)
    ordered = tuple(sorted(matches, key=lambda match: not match.relevant))
    answer = replace(answer, matches=ordered, things=ids, explanation=phrase_sentence(answer.phrase, ""))
    if ids and not anything:
        return answer
    return replace(
        answer,
        verdict="exact" if ids else "absent",
        relation="same" if ids else "absent",
        relation_subject=None,
        decided_by="name",
        probability=None,
        presence=None,
        label_set=(),
        coverage=None,
        threshold=None,
    )
