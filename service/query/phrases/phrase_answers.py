"""Answers to phrases: "the red mug left of the lamp", "how many cups?"."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.language.meaning.common_objects import is_toy
from fastsplat.service.query.language.sentences.sentences import doubt_of, quoted
from fastsplat.service.query.language.words.judgement import Ranked, Remarks, Verdict
from fastsplat.service.query.language.words.name_matching import NameIndex
from fastsplat.service.query.language.words.noun_phrases import noun_phrase, split_modifiers
from fastsplat.service.query.objects.absence import RATHER
from fastsplat.service.query.objects.names.object_names import ObjectNames
from fastsplat.service.query.objects.object_measures import ObjectMeasures
from fastsplat.service.query.phrases.object_looks import ObjectLooks
from fastsplat.service.query.phrases.phrase_solving import READ, PhraseSolver, Solved
from fastsplat.service.query.phrases.phrases import Named, ParsedQuestion, Phrase, Says
from fastsplat.service.query.phrases.relations import F64, asker_at
from fastsplat.service.query.phrases.written_words import WrittenWords
from fastsplat.service.scene.artefact.scene import Object, SurfaceKind
from fastsplat_contract.messages.phrases import PhraseAnswer, Refusal
from fastsplat_contract.messages.queries import Answer, Match, RelationSubject
from fastsplat_contract.messages.queries import Relation as Related

_WORDS: Mapping[SurfaceKind, str] = {
    "floor": "floor, ground",
    "wall": "wall",
    "ceiling": "ceiling",
    "horizontal surface": "table, desk, counter, countertop, tabletop, worktop, surface",
}
_KINDS: Mapping[str, SurfaceKind] = {word: kind for kind, words in _WORDS.items() for word in words.split(", ")}
_SIDES: tuple[SurfaceKind, ...] = ("floor", "wall", "ceiling")
"""Boundaries of a room, which are no objects in it."""
_LARGE = 0.5
"""Size share of the largest surface below which one is a detail."""


def surface_kind(noun: str) -> SurfaceKind:
    """Kind of surface that a noun names; "" for none."""
    return _KINDS.get(label_key(noun), "")


def unnamed_surfaces(kind: SurfaceKind, objects: Sequence[Object], measures: ObjectMeasures) -> tuple[int, ...]:
    """Ids of a kind's nameless surfaces, without small ones; only the largest horizontal one."""
    sizes = {}
    for obj in objects:
        shape = measures.shape(obj.id) if obj.surface == kind and not obj.name else None
        if shape is not None:
            sizes[obj.id] = float(np.linalg.norm(shape.size))
    most = max(sizes.values(), default=0.0)
    least = most if kind == "horizontal surface" else _LARGE * most
    return tuple(object_id for object_id, size in sizes.items() if size >= least)


def objects_in_room(objects: Sequence[Object], measures: ObjectMeasures) -> tuple[int, ...]:
    """Ids of all objects but nameless floors, walls and ceilings."""
    sides = {object_id for kind in _SIDES for object_id in unnamed_surfaces(kind, objects, measures)}
    return tuple(obj.id for obj in objects if obj.id not in sides)


_NOT_MEANT = ("referent_absent", "not_read")
"""Refusals after which a reading is discarded if there are others."""
_NOTHING, _CLOSE = ("absent", "undecided"), ("related", "possible")
Rank = Callable[[Sequence[str]], Sequence[Ranked]]
"""Ranks texts as if each were a name."""


@dataclass(frozen=True)
class AskedScene:
    """A scene as phrases use it."""

    objects: ObjectNames  # by their names
    names: NameIndex  # of the dictionary
    rank: Rank  # answers noun groups
    open_measures: Callable[[], ObjectMeasures]  # loads measures; called only if something must be measured
    unit: str  # of lengths: "m" or "unit"
    written: WrittenWords  # what is written on the objects
    looks: ObjectLooks  # what they look like


def answer_surface(plain: Ranked, scene: AskedScene) -> Ranked:
    """Falls back to nameless surfaces for "wall", "floor" or "table".

    They precede merely related objects ("plate" for "wall")."""
    answer = plain.answer
    kind = surface_kind(noun_phrase(answer.text)) if _is_unnamed(plain) else ""
    ids = unnamed_surfaces(kind, scene.objects.present, scene.open_measures()) if kind else ()
    if not ids:
        return plain
    sure = kind != "horizontal surface"
    about = replace(_about(answer, scene.objects, ids), relation="same" if sure else "related")
    return Ranked(about, "exact" if sure else "possible", remarks=Remarks(by_shape=True))


def answer_written(plain: Ranked, scene: AskedScene) -> Ranked:
    """Falls back to objects with these words written on them.

    They precede objects merely related to several words ("glass" for "oat milk"). Such objects may be it, or be about
    it.
    """
    words = noun_phrase(plain.answer.text)
    nowhere = plain.verdict in _NOTHING or (_is_unnamed(plain) and " " in words)
    if not nowhere or not scene.written.bearing(words):
        return plain
    says = Says(words, False, f"where it says {quoted(words)}")
    question = ParsedQuestion("objects", (Phrase("", "", conditions=(says,)),), "")
    found = answer_phrase(question, plain, scene, None)
    may_be = replace(found.answer, relation="related", probability=None)
    return found if found.verdict == "undecided" else replace(found, answer=may_be, verdict="possible")


def answer_by_looks(question: ParsedQuestion | None, plain: Ranked, scene: AskedScene) -> Ranked:
    """Falls back to objects that look like the text.

    Meanings of names and looks are combined in one likelihood per object, with a uniform prior for nameless objects.
    Looks decide no places, possessions, writing, orders or counts."""
    answer, objects = plain.answer, scene.objects
    if not scene.looks or not _is_unnamed(plain) or not _is_of_looks(question, plain):
        return plain
    likely = scene.looks.likely(noun_phrase(answer.text), meant_by_names(answer, objects))
    ordered = sorted(likely, key=lambda object_id: -likely[object_id])
    ids = tuple(object_id for object_id in ordered if likely[object_id] >= RATHER)
    related = answer.probability or 0.0 if plain.verdict in _CLOSE else 0.0
    if not ids or likely[ids[0]] <= related:
        return plain
    about = replace(_about(answer, objects, ids), relation="related", phrase=None, probability=likely[ids[0]])
    return Ranked(about, "possible", remarks=Remarks(by_looks=True))


def meant_by_names(answer: Answer, objects: ObjectNames) -> Mapping[int, float]:
    """Probability of each object by the meaning of its name; uniform for nameless objects."""
    by_label = {match.label_id: match.probability for match in answer.matches}
    unknown = 1.0 / (1 + len(objects.present))
    meant = {obj.id: by_label.get(objects.dictionary.id_of(obj.name) or 0) for obj in objects.present}
    return {object_id: unknown if likely is None else likely for object_id, likely in meant.items()}


def _is_of_looks(question: ParsedQuestion | None, plain: Ranked) -> bool:
    """True if a text without a match only names and describes an object."""
    phrase = plain.answer.phrase
    if question is None or phrase is None:
        return True
    unnamed = plain.remarks.head or (phrase.refusal is not None and phrase.refusal.reason == "not_named")
    more = any(reading.conditions or reading.rank is not None for reading in question.readings)
    return bool(unnamed) and not (more or question.not_understood) and question.asks != "count"


def _is_unnamed(plain: Ranked) -> bool:
    """True if nothing bears the requested name or a kind of it."""
    return plain.verdict in _NOTHING or (plain.verdict in _CLOSE and plain.answer.relation == "related")


def answer_phrase(question: ParsedQuestion, plain: Ranked, scene: AskedScene, world_from_camera: F64 | None) -> Ranked:
    """Answers a parsed question."""
    text = plain.answer.text
    objects = scene.objects
    spoken = {name for reading in question.readings for name in _names_in(reading)}
    groups = sorted(spoken - {""})
    ranked = dict(zip(groups, scene.rank(groups), strict=True)) if groups else {}
    named = {name: _named(name, ranking, scene) for name, ranking in ranked.items()}
    if "" in spoken:
        ids = objects_in_room(objects.present, scene.open_measures())
        if question.of_writing:
            ids = tuple(obj.id for obj in objects.present)  # a wall is no object in a room, but words may be on it
        named[""] = Named(ids, by_name=True)
    asker = None
    if world_from_camera is not None:
        measures = scene.open_measures()
        asker = asker_at(world_from_camera, measures.axes, measures.up is not None)
    by_id = {obj.id: obj for obj in (*objects.present, *objects.parts)}
    solver = PhraseSolver(scene.open_measures, by_id, named, asker, scene.unit, scene.written)
    solved = _agreed([solver.solve(reading) for reading in question.readings], question)
    reading = question.readings[0]
    head = ranked[reading.group if solved.named.whole else reading.head] if reading.head else plain
    refusal = _refusal(question, solved)
    nowhere = bool(reading.head) and head.verdict == "absent" and refusal == Refusal("not_named", reading.head)
    if nowhere:
        refusal = None  # where nothing is that, nothing is that anywhere
    unnamed = plain.answer.searched.unnamed_objects
    counted = refusal is None and not (nowhere and unnamed)  # one without a name may be it
    phrase = PhraseAnswer(
        asks=question.asks,
        head=reading.head,
        conditions=reading.said,
        not_understood=question.not_understood,
        object_ids=solved.objects,
        undecided=tuple(solved.undecided),
        witnesses=solved.witnesses,
        count=len(objects.counted_once(solved.objects)) if question.asks == "count" and counted else None,
        refusal=refusal,
    )
    if refusal is not None:
        if _is_of_the_meaning(refusal, question, plain, solved.named):
            return plain
        may_be = phrase.undecided or (solved.named.ids if reading.head else ())
        return Ranked(replace(_about(plain.answer, objects, may_be), phrase=phrase), "undecided")
    if nowhere:
        ordered = tuple(match._replace(relevant=False) for match in head.answer.matches)
        answer = replace(head.answer, text=text, phrase=phrase, matches=ordered, object_ids=())
        return Ranked(answer, "absent", head.named, remarks=replace(head.remarks, head=reading.head))
    compared = (object_id for witness in phrase.witnesses for object_id in witness.compared_ids)
    taking_part = {*phrase.object_ids, *compared}
    spoken_of = [named[name] for name in sorted(_names_in(reading)) if taking_part & {*named[name].ids}]
    read = [witness for witness in solved.witnesses if witness.measure == READ and witness.clearness > 0]
    values = (witness.value for witness in read if witness.value)
    likely = min((*(group.likely for group in spoken_of), *values), default=1.0)
    doubt = next((group.doubt for group in spoken_of if group.doubt), solved.doubt)
    return _decided(replace(head.answer, text=text, phrase=phrase), objects, likely, doubt)


def closest_kind(plain: Ranked, scene: AskedScene) -> Ranked:
    """Falls back to a name's last words or a toy: "black bear" to teddy."""
    if plain.verdict != "absent":
        return plain
    phrase = noun_phrase(plain.answer.text)
    _, head = split_modifiers(phrase)
    toys = [hyponym for hyponym in scene.names.match(phrase).hyponyms if hyponym in scene.objects.table]
    toys = [toy for toy in toys if is_toy(scene.objects.table[toy].label)]
    if not toys and head == label_key(phrase):  # it was ranked already
        return plain
    (found,) = scene.rank((scene.objects.table[toys[0]].label if toys else head,))
    if not found.standing:
        return plain
    unchecked = label_key(phrase).removesuffix(head).strip()
    relation: tuple[Related, RelationSubject | None] = ("related", None) if unchecked else ("kind_of", "label")
    answer = replace(found.answer, text=plain.answer.text, relation=relation[0], relation_subject=relation[1])
    verdict: Verdict = "related" if found.verdict == "exact" else found.verdict
    return replace(found, answer=answer, verdict=verdict, remarks=replace(found.remarks, unchecked=unchecked))


def _refusal(question: ParsedQuestion, solved: Solved) -> Refusal | None:
    """Reason why nothing is decided; None if something is.

    A count requires that each object is decided and bears the name."""
    if question.not_understood:
        return Refusal("not_understood", question.not_understood)
    if solved.refusal is not None:
        return solved.refusal
    counts, named = question.asks == "count", solved.named
    if counts and solved.undecided:
        return next(iter(solved.undecided.values()))
    if (counts and named.suggested) or not (solved.objects or named.by_name):
        return Refusal("not_named", question.readings[0].head)
    return None


def _is_of_the_meaning(refusal: Refusal, question: ParsedQuestion, plain: Ranked, named: Named) -> bool:
    """True if the meaning of the whole text answers instead: "light with a match"."""
    answered = plain.verdict in _CLOSE and not plain.named and not named.by_name
    unmeasured = refusal.reason in ("not_understood", "not_named", "not_measured")
    return answered and unmeasured and question.asks != "count"


def _names_in(phrase: Phrase) -> set[str]:
    """Noun groups of a phrase, nested ones included; "" for anything."""
    names = {phrase.head, phrase.group} if phrase.head else {""}
    return names.union(*map(_names_in, phrase.inner))


def _named(name: str, ranked: Ranked, scene: AskedScene) -> Named:
    """Objects that a noun group names, by name or kind, else fitting nameless surfaces."""
    answer, match = ranked.answer, scene.names.match(name)
    below = answer.relation_subject == "question" and answer.relation == "kind_of"
    any_kind = below and not ranked.standing
    labels = [label_id for label_id in answer.relevant_ids if any_kind or label_id in ranked.standing]
    ids = scene.objects.of_labels(labels)
    kind = "" if ids else surface_kind(name)
    if kind:
        surfaces = unnamed_surfaces(kind, scene.objects.present, scene.open_measures())
        doubt = f"what is {quoted(name)} is told by shape and place" if kind == "horizontal surface" else ""
        return Named(surfaces, by_name=bool(surfaces), likely=1.0, doubt=doubt)
    return Named(
        ids,
        by_name=ranked.named and ranked.verdict != "undecided",
        suggested=bool(ids) and not any(map(scene.objects.is_borne, labels)),
        whole=answer.relation == "same" and bool(match.exact) and not match.unchecked,
        likely=answer.probability if ids and answer.probability is not None else 1.0,
        doubt=doubt_of(answer, scene.objects) if ranked.verdict == "possible" and ids else "",
    )


def _agreed(readings: Sequence[Solved], question: ParsedQuestion) -> Solved:
    """The common result of all readings, else "ambiguous".

    Readings about absent objects, and empty ones if another has results, are discarded."""
    first = readings[0]
    sensible = [reading for reading in readings if reading.refusal is None or reading.refusal.reason not in _NOT_MEANT]
    some = [reading for reading in sensible if reading.objects or reading.refusal is not None]
    meant = sensible if question.asks == "count" else some or sensible
    meant = meant or [first]
    outcomes = {(reading.objects, frozenset(reading.undecided), reading.refusal) for reading in meant}
    if len(outcomes) == 1:
        return meant[0]
    part = " ".join(question.readings[0].said)
    return replace(first, objects=(), undecided={}, refusal=Refusal("ambiguous", part))


def _about(answer: Answer, objects: ObjectNames, ids: tuple[int, ...]) -> Answer:
    """Undecided answer about some objects: their names first, without the ranking's probabilities."""
    names = [objects.called[object_id] for object_id in reversed(ids)]
    order = {objects.dictionary.id_of(name): -at for at, name in enumerate(names)}

    def place(match: Match) -> tuple[int, float]:
        return order.get(match.label_id, 1), -(match.relevancy if match.probability is None else match.probability)

    matches = [match._replace(relevant=match.label_id in order) for match in answer.matches]
    nameless = bool(ids) and not any(match.relevant for match in matches)
    return replace(
        answer,
        matches=() if nameless else tuple(sorted(matches, key=place)),  # the first one is the answer's name
        object_ids=ids,
        relation="undecided",
        relation_subject=None,
        probability=None,
        presence=None,
        label_set=(),
        coverage=None,
    )


def _decided(answer: Answer, objects: ObjectNames, likely: float, doubt: str) -> Ranked:
    assert answer.phrase is not None
    ids = answer.phrase.object_ids
    decided = replace(
        _about(answer, objects, ids),
        relation="same" if ids else "absent",
        probability=likely if ids and likely < 1.0 else None,
    )
    verdict: Verdict = ("possible" if doubt or likely < RATHER else "exact") if ids else "absent"
    return Ranked(decided, verdict, remarks=Remarks(doubt=doubt))
