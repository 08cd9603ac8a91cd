"""Answers that need no Gaussians: everything but images, masks and measurements."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.language.absence_policy import Vocabulary, with_absence_judged
from fastsplat.service.query.language.ranking import Ranker
from fastsplat.service.query.language.sentences.history_answers import HistoryAnswers
from fastsplat.service.query.language.sentences.sentences import spoken
from fastsplat.service.query.language.sentences.time_questions import TimeQuestion, time_question
from fastsplat.service.query.language.words.english import is_foreign, names_nothing
from fastsplat.service.query.language.words.judgement import Ranked
from fastsplat.service.query.language.words.query_text import TextQuery
from fastsplat.service.query.phrases.phrase_grammar import parsed_questions
from fastsplat.service.query.phrases.phrases import ParsedQuestion
from fastsplat.service.query.phrases.thing_looks import LooksModel, ThingLooks
from fastsplat.service.query.phrases.thing_words import ThingWords
from fastsplat.service.query.phrases.written_words import WrittenWords
from fastsplat.service.query.things.absence import UnseenSpace
from fastsplat.service.query.things.names.names_by_looks import KnownThing, NameFromScene, names_by_looks
from fastsplat.service.query.things.names.names_by_tags import names_by_tags
from fastsplat.service.query.things.names.thing_names import ThingNames
from fastsplat.service.query.things.thing_history import SceneHistory
from fastsplat.service.scene.artefact.scene import Gaussians, Scene, provisional_of
from fastsplat_contract.messages.queries import Answer

if TYPE_CHECKING:
    from fastsplat.service.query.things.names.look_alikes import Sizes
    from fastsplat.service.query.things.thing_index import SceneThings

_MAY_ASK_OF_TIME = re.compile(r"\b(?:what|which|when|was|were|is|are|has|have|did|since)\b", re.IGNORECASE)
"""Every question about time contains one of these words."""
_PER_THING = 1_024
"""Estimated bytes of a thing: its table row, its index entry and its suggestions."""


class RankedScene:
    """Labels and thing names of one scene, ready for queries; thread-safe.

    Args:
        scene: only its array shapes are kept.
        looks: compares texts with the appearance of things; None: disabled.
        sizes: sizes of its things, see `sizes_in_meters`; None: unknown.

    Attributes:
        elsewhere: names suggested by other scenes, by thing id.
        blank: zero Gaussians in the scene's shapes; broadcast, so they take no memory.
    """

    def __init__(
        self,
        scene: Scene,
        ranker: Ranker,
        names: ThingNames,
        unseen: UnseenSpace,
        history: SceneHistory,
        looks: LooksModel | None = None,
        sizes: Sizes | None = None,
    ) -> None:
        self.ranker = ranker
        self.names = names
        self._words = ThingWords(names)
        self._vocabulary = Vocabulary(names.searched_for, ranker.lexicon)
        self._written = WrittenWords(tuple(thing for thing in names.present if thing.reads))
        self._looks = ThingLooks(names.present, looks)
        self._unseen = unseen
        self._history = history
        self._provisional = provisional_of(scene.quality)
        self.elsewhere: Mapping[int, NameFromScene] = {}
        self._suggesting: tuple[Sequence[KnownThing], RankedScene | None] = (), None
        self.sizes: Sizes = {} if sizes is None else sizes
        self._unit = "m" if scene.scale == "METRIC" else "unit"
        shapes = {name: array.shape for name, array in vars(scene.gaussians).items()}
        self.blank = Gaussians(**{name: np.broadcast_to(np.float32(0), shape) for name, shape in shapes.items()})

    @property
    def nbytes(self) -> int:
        """Estimated bytes in memory, independent of the number of Gaussians."""
        things = (*self.names.present, *self.names.parts)
        looks = sum(len(thing.appearance) for thing in things)
        looks += sum(len(thing.looks.embedding) for thing in things if thing.looks is not None)
        rankers = 2 if looks or self.names.sources else 1  # what is known of other scenes makes another one
        return rankers * self.ranker.nbytes + _PER_THING * len(things) + looks

    def suggesting(self, known: Sequence[KnownThing], scene_id: str) -> RankedScene:
        """Returns this scene with suggestions from other scenes of the project.

        Names in `known` of this scene are ignored; those of others also weight the sources. The last result is cached
        by identity of `known`."""
        seen, other = self._suggesting
        if seen is not known:
            others = [one for one in known if one.scene_id != scene_id]
            things = self.names.present
            elsewhere = {**names_by_looks(things, others, self.sizes), **names_by_tags(things, others)}
            said = tuple(each for one in others for each in one.said if each.source in self.names.sources)
            needed = bool(elsewhere or said)
            if needed and (other is None or (other.elsewhere, other.names.said_elsewhere) != (elsewhere, said)):
                names = self.names.suggesting(elsewhere, said)
                other = copy.copy(self)
                other.ranker, other.names, other._words = self.ranker.suggesting(names), names, ThingWords(names)
                other.elsewhere = elsewhere
            other = other if needed else None
            self._suggesting = known, other
        return other or self

    def answer(
        self, query: TextQuery, things: Callable[[], SceneThings], asker: NDArray[np.float64] | None = None
    ) -> tuple[Answer, ...]:
        """Answers each text of a checked query, in order; every answer ranks all names.

        `things` loads the scene's things, only for measurements, sentences about unnamed things, or if none are stored.
        `asker` is float64 [4, 4], world from asker."""
        if not any(map(_MAY_ASK_OF_TIME.search, query.texts)) and not self._history.looked_at_again:
            return tuple(self._in_words(ranked, things, None) for ranked in self.decided(query, things, asker))
        now = datetime.now(UTC)
        questions = [time_question(text, now) for text in query.texts]
        pairs = zip(questions, query.texts, strict=True)
        # A question about moves alone names nothing: a negative is ranked in its place, and its matches are not
        # reported.
        texts = tuple(text if asked is None else asked.about or query.negatives[0] for asked, text in pairs)
        ranked = self.decided(replace(query, texts=texts), things, asker)
        answers = (self._in_words(each, things, asked) for each, asked in zip(ranked, questions, strict=True))
        return tuple(replace(answer, text=text) for answer, text in zip(answers, query.texts, strict=True))

    def _in_words(self, ranked: Ranked, things: Callable[[], SceneThings], question: TimeQuestion | None) -> Answer:
        words = self._words
        if (ranked.answer.things or self._history.looked_at_again) and not self.names.stored:
            words = ThingWords(things().names)

        def in_words(thing_ids: Sequence[int]) -> str:
            return words.listed(thing_ids, lambda: things().measures)

        answer = spoken(ranked, words.names, self._unseen, in_words)
        if question is not None or self._history.looked_at_again:
            unit = "m" if self._unit == "m" else "scene units"
            of_time = HistoryAnswers(self._history, words.names, in_words, unit)
            answer = of_time.plain(answer) if question is None else of_time.asked(question, answer)
        return replace(words.names.counted(answer), provisional=self._provisional)

    def decided(
        self, query: TextQuery, things: Callable[[], SceneThings], asker: NDArray[np.float64] | None = None
    ) -> Sequence[Ranked]:
        """Ranks and judges each text before sentences are written; arguments as in `answer`."""
        ranked = self.ranker.rank(query)
        parsed = parsed_questions(query.texts, self.ranker.names, self.ranker.is_name, self._written)
        # A "black bear" that the lexicon knows and the scene lacks may be a bear that is black.
        gone = [each.answer.text if each.verdict == "absent" else "" for each in ranked]
        parted = parsed_questions(gone, self.ranker.names, self.ranker.names.has, self._written)
        told = self._looks or any(thing.surface or thing.reads for thing in self.names.present)

        def color_share(thing_id: int, name: str) -> float:
            color = things().measures.color(thing_id)
            return 0.0 if color is None else color.shares.get(name, 0.0)

        def judged(each: Ranked) -> Ranked:
            return with_absence_judged(each, self.names, self._vocabulary, color_share)

        toys = any(text and self.ranker.names.match(text).hyponyms for text in gone)
        if not any(parsed) and not any(parted) and not toys and not told:
            return tuple(map(judged, ranked))
        from fastsplat.service.query.phrases.phrase_answers import (
            AskedScene,
            answer_by_looks,
            answer_phrase,
            answer_surface,
            answer_written,
            closest_kind,
        )

        def rank(texts: Sequence[str]) -> tuple[Ranked, ...]:
            return self.ranker.rank(replace(query, texts=tuple(texts)))

        names = self.names if self.names.stored else things().names
        scene = AskedScene(
            names, self.ranker.names, rank, lambda: things().measures, self._unit, self._written, self._looks
        )

        def answered(plain: Ranked, phrase: ParsedQuestion | None, parted: ParsedQuestion | None) -> Ranked:
            if names_nothing(plain.answer.text):
                return plain
            if is_foreign(plain.answer.text) and not (phrase and phrase.of_writing):
                return answer_written(plain, scene)
            if phrase is None and parted is not None:
                found = answer_phrase(parted, plain, scene, asker)
                if found.verdict in ("exact", "possible"):
                    return found
            if phrase is None:
                named = answer_surface(closest_kind(plain, scene), scene)
                return answer_by_looks(None, answer_written(named, scene), scene)
            return answer_by_looks(phrase, answer_phrase(phrase, plain, scene, asker), scene)

        return tuple(judged(answered(*each)) for each in zip(ranked, parsed, parted, strict=True))
