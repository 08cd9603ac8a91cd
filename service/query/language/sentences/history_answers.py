"""Answers about changes over time, from a scene's stored observations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime

from fastsplat.service.query.language.sentences.change_sentences import change_sentence
from fastsplat.service.query.language.sentences.sentences import InWords, enumerated, percent
from fastsplat.service.query.language.sentences.time_questions import TimeQuestion, When
from fastsplat.service.query.objects.names.object_names import ObjectNames
from fastsplat.service.query.objects.object_history import SceneHistory, Sighting
from fastsplat_contract.messages.queries import Answer, Outcome
from fastsplat_contract.photos.localization import SceneChange

_MOST_TOLD = 5


class HistoryAnswers:
    """Answers from a scene's history; `unit` is "m" or "scene units"."""

    def __init__(self, history: SceneHistory, names: ObjectNames, in_words: InWords, unit: str) -> None:
        self._history = history
        self._parents = {part.id: part.parent for part in names.parts}
        self._names = names
        self._in_words = in_words
        self._unit = unit

    def plain(self, answer: Answer) -> Answer:
        """Adds later changes to an answer; "not here" if all objects are missing."""
        if answer.outcome not in ("here", "probably_here"):
            return answer
        objects = self._objects(answer)
        changed = [object_id for object_id in objects if self._change(object_id) is not None]
        missing = [object_id for object_id in changed if self._missing_since(object_id) is not None]
        text = " ".join(map(self._last_change, changed[:_MOST_TOLD]))
        if not changed:
            return answer
        if len(missing) < len(objects):
            return _saying(answer, answer.outcome, f"{answer.sentence} {text}")
        where = "its place is that where it was" if len(missing) == 1 else "their places are those where they were"
        return _saying(answer, "not_here", f"Not here any more: {self._in_words(objects)}; {where}. {text}")

    def answer_to(self, question: TimeQuestion, answer: Answer) -> Answer:
        """Answers a question about time, given the answer to its words for objects."""
        if question.asks == "events":
            return self._events(question, answer)
        objects = self._objects(answer)
        if not objects or answer.outcome not in ("here", "probably_here"):
            return answer
        opening = "" if answer.outcome == "here" else f"Probably{percent(answer.probability)}: "
        if question.asks == "place":
            assert question.when is not None
            sentences = [self._place_at(object_id, question.when) for object_id in objects[:_MOST_TOLD]]
        else:
            sentences = [self._seen(object_id) for object_id in objects[:_MOST_TOLD]]
        more = len(objects) - _MOST_TOLD
        sentence = opening + " ".join(sentences) + (f" There are {more} more." if more > 0 else "")
        gone = question.asks == "last_seen" and all(self._missing_since(object_id) is not None for object_id in objects)
        return _saying(answer, "not_here" if gone else answer.outcome, sentence)

    def _objects(self, answer: Answer) -> Sequence[int]:
        """The objects that answer, also of a scene that stores none."""
        return answer.object_ids or self._names.of_labels(answer.relevant_ids)

    def _events(self, question: TimeQuestion, answer: Answer) -> Answer:
        observations, since = self._history.later, question.when
        about = replace(
            answer, label_set=(), coverage=None, presence=None, phrase=None, object_ids=(), matches=(),
            relation_subject=None, probability=None,
        )  # fmt: skip
        fresh = [observation for observation in observations if since is None or observation.seen_at >= since.start]
        if not fresh:
            period = "" if since is None else f" since {_day(since.start)}"
            scene_date = "" if self._history.made_at is None else f"; the scene is of {_day(self._history.made_at)}"
            nothing = f"Cannot say: no photos of another day are kept with this scene{period}{scene_date}."
            return _saying(replace(about, relation="undecided"), "cannot_say", nothing)
        changes = self._changes(question)
        seen = {object_id for observation in fresh for object_id in observation.looked_at}
        days = enumerated(list(dict.fromkeys(_day(observation.seen_at) for observation in fresh))[-_MOST_TOLD:])
        if not changes:
            total = max(len(self._names.present), len(seen))
            share = f"{len(seen)} of {total}" if len(seen) < total else f"{total}"
            objects = f"{share} object{'' if total == 1 else 's'}"
            none = f"{_nothing(question)}: photos of {days} looked at {objects}."
            return _saying(replace(about, relation="absent"), "not_here", none)
        text = " ".join(self._sentence(change) for change, _ in changes[:_MOST_TOLD])
        more = f" There are {len(changes) - _MOST_TOLD} more." if changes[_MOST_TOLD:] else ""
        ids = tuple(change.object_id for change, _ in changes if change.object_id)
        probability = min(change.probability for change, _ in changes)
        about = replace(about, relation="same", object_ids=ids, probability=probability)
        return _saying(about, "here", f"By photos of {days}: {text}{more}")

    def _changes(self, question: TimeQuestion) -> list[tuple[SceneChange, datetime]]:
        """Requested changes that still hold by the last observation, surest first."""
        found: list[tuple[SceneChange, datetime]] = []
        for sightings in self._history.looked_at_again.values():
            last = sightings[-1]
            if last.change is None or last.change.kind not in question.events:
                continue
            if question.when is not None:
                before = [sighting for sighting in sightings if sighting.at < question.when.start]
                same = before and before[-1].change is not None and before[-1].change.kind == last.change.kind
                if last.at < question.when.start or same:
                    continue
            found.append((last.change, last.at))
        for observation in self._history.later[-1:]:
            if question.when is None or observation.seen_at >= question.when.start:
                nameless = [change for change in observation.changes if not change.object_id]
                found += [(change, observation.seen_at) for change in nameless if change.kind in question.events]
        return sorted(found, key=lambda pair: -pair[0].probability)

    def _place_at(self, object_id: int, when: When) -> str:
        """Sentence about an object's place on a day, by the last photos until its end."""
        name = self._name(object_id)
        known = [sighting for sighting in self._sightings(object_id) if sighting.at < when.end]
        day = _day(when.start)
        if known:
            last = known[-1]
            late = "" if last.at >= when.start else f", nobody having looked on {day}"
            if last.change is None:
                return f"{name} was where the scene shows it, by photos of {_day(last.at)}{late}."
            return f"By photos of {_day(last.at)}{late}: {self._sentence(last.change)}"
        made_at = self._history.made_at
        if made_at is None:
            unknown = "the scene's own do not say when they were taken"
            return f"No photo of {day} or before shows {name[0].lower()}{name[1:]}, and {unknown}."
        return f"No photo is of {day} or before: the scene is of {_day(made_at)}."

    def _seen(self, object_id: int) -> str:
        seen, name = self._history.last_seen(self._whole(object_id)), self._name(object_id)
        if self._missing_since(object_id) is not None:
            return self._last_change(object_id)
        if seen is None:
            return f"{name} is in the scene, whose photos do not say when they were taken."
        change = self._change(object_id)
        moved = "" if change is None else f" {self._sentence(change)}"
        return f"{name} was last seen on {_day(seen)}.{moved}"

    def _last_change(self, object_id: int) -> str:
        since, seen = self._missing_since(object_id), self._history.last_seen(self._whole(object_id))
        last = self._sightings(object_id)[-1]
        assert last.change is not None
        if since is None:
            return f"By photos of {_day(last.at)}: {self._sentence(last.change)}"
        before = f", and was last seen on {_day(seen)}" if seen is not None else ""
        return f"{self._name(object_id)} is missing since {_day(since)}{before}."

    def _sentence(self, change: SceneChange) -> str:
        name = self._names.called.get(change.object_id, change.name)
        said = change_sentence(change.kind, change.object_id, name, change.distance, self._unit == "m")
        place = change.after if change.kind in ("moved", "new") else None if change.object_id else change.before
        if place is None:
            return said
        x, y, z = place.center.position
        return f"{said[:-1]}, {'to' if change.kind == 'moved' else 'at'} ({x:.2f}, {y:.2f}, {z:.2f}) {self._unit}."

    def _name(self, object_id: int) -> str:
        said = self._in_words((object_id,))
        return f"The {said}" if said.startswith('"') else said[0].upper() + said[1:]

    def _whole(self, object_id: int) -> int:
        return self._parents.get(object_id, object_id)

    def _sightings(self, object_id: int) -> Sequence[Sighting]:
        return self._history.sightings(self._whole(object_id))

    def _change(self, object_id: int) -> SceneChange | None:
        """What its last sighting says of a change."""
        sightings = self._sightings(object_id)
        return sightings[-1].change if sightings else None

    def _missing_since(self, object_id: int) -> datetime | None:
        return self._history.missing_since(self._whole(object_id))


def _saying(answer: Answer, outcome: Outcome, sentence: str) -> Answer:
    return replace(answer, outcome=outcome, sentence=sentence)


def _nothing(question: TimeQuestion) -> str:
    if len(question.events) > 2:
        return "Nothing has changed"
    return "Nothing has moved" if "moved" in question.events else f"Nothing is {min(question.events & {'gone', 'new'})}"


def _day(at: datetime) -> str:
    return f"{at.day} {at:%B %Y}"
