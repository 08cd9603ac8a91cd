"""Answers that need no Gaussians: everything but images, masks and measurements."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache, partial
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
from fastsplat.service.query.objects.absence import UnseenSpace
from fastsplat.service.query.objects.names.names_from_scenes import (
    KnownObject,
    NameFromScene,
    names_by_looks,
    names_by_tags,
)
from fastsplat.service.query.objects.names.object_names import ObjectNames
from fastsplat.service.query.objects.object_history import SceneHistory
from fastsplat.service.query.phrases.object_looks import LooksModel, ObjectLooks
from fastsplat.service.query.phrases.object_words import ObjectWords
from fastsplat.service.query.phrases.phrase_grammar import parsed_questions
from fastsplat.service.query.phrases.phrases import ParsedQuestion
from fastsplat.service.query.phrases.written_words import WrittenWords
from fastsplat.service.scene.artefact.scene import Gaussians, Scene
from fastsplat_contract.messages.queries import Answer

if TYPE_CHECKING:
    from fastsplat.service.query.objects.names.look_alikes import Sizes
    from fastsplat.service.query.objects.object_index import SceneObjects

_MAY_ASK_OF_TIME = re.compile(r"\b(?:what|which|when|was|were|is|are|has|have|did|since)\b", re.IGNORECASE)
"""Every question about time contains one of these words."""
_PER_OBJECT = 1_024
"""Estimated bytes of an object: its table row, its index entry and its suggestions."""


class RankedScene:
    """Labels and object names of one scene, ready for queries; thread-safe.

    Args:
        scene: only its array shapes are kept.
        looks: compares texts with the appearance of objects; None: disabled.
        sizes: sizes of its objects, see `sizes_in_meters`; None: unknown.

    Attributes:
        elsewhere: names suggested by other scenes, by object id.
        blank: zero Gaussians in the scene's shapes; broadcast, so they take no memory.
    """

    def __init__(
        self,
        scene: Scene,
        ranker: Ranker,
        names: ObjectNames,
        unseen: UnseenSpace,
        history: SceneHistory,
        looks: LooksModel | None = None,
        sizes: Sizes | None = None,
    ) -> None:
        self.ranker = ranker
        self.names = names
        self.words = ObjectWords(names)
        self.vocabulary = Vocabulary(names.searched_for, ranker.lexicon, scene.facts.found_shares)
        self.written = WrittenWords(tuple(obj for obj in names.present if obj.reads))
        self.looks = ObjectLooks(names.present, looks)
        self.unseen = unseen
        self.history = history
        self.provisional = scene.facts.draft
        self.elsewhere: Mapping[int, NameFromScene] = {}
        self._suggesting: tuple[Sequence[KnownObject], RankedScene | None] = (), None
        self.sizes: Sizes = {} if sizes is None else sizes
        self.unit = "m" if scene.scale == "METRIC" else "unit"
        shapes = {name: array.shape for name, array in vars(scene.gaussians).items()}
        self.blank = Gaussians(**{name: np.broadcast_to(np.float32(0), shape) for name, shape in shapes.items()})

    @property
    def nbytes(self) -> int:
        """Estimated bytes in memory, independent of the number of Gaussians."""
        objects = (*self.names.present, *self.names.parts)
        looks = sum(len(obj.appearance) for obj in objects)
        looks += sum(len(obj.looks.embedding) for obj in objects if obj.looks is not None)
        rankers = 2 if looks or self.names.sources else 1  # what is known of other scenes makes another one
        return rankers * self.ranker.nbytes + _PER_OBJECT * len(objects) + looks

    def suggesting(self, known: Sequence[KnownObject], scene_id: str) -> RankedScene:
        """Returns this scene with suggestions from other scenes of the project.

        Names in `known` of this scene are ignored; those of others also weight the sources. The last result is cached
        by identity of `known`."""
        seen, scene = self._suggesting
        if seen is not known:
            known_objects = [obj for obj in known if obj.scene_id != scene_id]
            objects = self.names.present
            elsewhere = {**names_by_looks(objects, known_objects, self.sizes), **names_by_tags(objects, known_objects)}
            said = tuple(name for obj in known_objects for name in obj.said if name.source in self.names.sources)
            needed = bool(elsewhere or said)
            if needed and (scene is None or (scene.elsewhere, scene.names.said_elsewhere) != (elsewhere, said)):
                names = self.names.suggesting(elsewhere, said)
                scene = copy.copy(self)
                scene.ranker, scene.names, scene.words = self.ranker.suggesting(names), names, ObjectWords(names)
                scene.elsewhere = elsewhere
            scene = scene if needed else None
            self._suggesting = known, scene
        return scene or self


class RankedQuery:
    """A query ranked and parsed once for a scene, answered from any pose."""

    def __init__(self, scene: RankedScene, query: TextQuery) -> None:
        now = datetime.now(UTC)
        self._scene, self._query, self._day = scene, query, now.date()
        self._questions = [time_question(text, now) if _MAY_ASK_OF_TIME.search(text) else None for text in query.texts]
        pairs = zip(self._questions, query.texts, strict=True)
        # A question about moves alone names nothing: a negative is ranked in its place, and its matches are not
        # reported.
        texts = tuple(text if question is None else question.about or query.negatives[0] for question, text in pairs)
        self._ranked, names = scene.ranker.rank(replace(query, texts=texts)), scene.ranker.names
        self._rank = cache(lambda texts: scene.ranker.rank(replace(query, texts=texts)))
        self._parsed = parsed_questions(texts, names, scene.ranker.is_name, scene.written)
        # A "black bear" that the lexicon knows and the scene lacks may be a bear that is black.
        gone = [ranked.answer.text if ranked.verdict == "absent" else "" for ranked in self._ranked]
        self._parted = parsed_questions(gone, names, names.has, scene.written)
        has_details = scene.looks or any(obj.surface or obj.reads for obj in scene.names.present)
        toys = any(text and names.match(text).hyponyms for text in gone)
        self._is_plain = not any(self._parsed) and not any(self._parted) and not toys and not has_details
        questions = (question for question in (*self._parsed, *self._parted) if question is not None)
        self._is_of_pose = any(question.is_of_pose for question in questions)
        self._answers: tuple[Answer, ...] | None = None

    def is_of(self, scene: RankedScene, query: TextQuery) -> bool:
        """True if it ranks this query to this scene, and "yesterday" is still the same day."""
        return self._scene is scene and (self._query, self._day) == (query, datetime.now(UTC).date())

    def answer(
        self, objects: Callable[[], SceneObjects], asker: NDArray[np.float64] | None = None
    ) -> tuple[Answer, ...]:
        """Answers each text, in order; every answer ranks all names.

        `objects` loads the scene's objects, only for measurements, sentences about unnamed objects, or if none are
        stored. `asker` is float64 [4, 4], world from asker."""
        if self._answers is None or self._is_of_pose:
            answers = map(partial(self._in_words, objects), self.decided(objects, asker), self._questions)
            texts = self._query.texts
            self._answers = tuple(replace(answer, text=text) for answer, text in zip(answers, texts, strict=True))
        return self._answers

    def _in_words(self, objects: Callable[[], SceneObjects], ranked: Ranked, question: TimeQuestion | None) -> Answer:
        scene, words = self._scene, self._scene.words
        if (ranked.answer.object_ids or scene.history.looked_at_again) and not scene.names.stored:
            words = ObjectWords(objects().names)

        def in_words(object_ids: Sequence[int]) -> str:
            return words.listed(object_ids, lambda: objects().measures)

        answer = spoken(ranked, words.names, scene.unseen, in_words)
        if question is not None or scene.history.looked_at_again:
            unit = "m" if scene.unit == "m" else "scene units"
            of_time = HistoryAnswers(scene.history, words.names, in_words, unit)
            answer = of_time.plain(answer) if question is None else of_time.answer_to(question, answer)
        return replace(words.names.counted(answer), provisional=scene.provisional)

    def decided(
        self, objects: Callable[[], SceneObjects], asker: NDArray[np.float64] | None = None
    ) -> Sequence[Ranked]:
        """Judges each text before sentences are written; arguments as in `answer`."""
        scene = self._scene

        def color_share(object_id: int, name: str) -> float:
            color = objects().measures.color(object_id)
            return 0.0 if color is None else color.shares.get(name, 0.0)

        def presence_by_looks(ranked: Ranked, nameless: Collection[int]) -> float | None:
            from fastsplat.service.query.phrases.phrase_answers import meant_by_names

            if not scene.looks or not scene.looks.ids.issuperset(nameless):
                return None
            return scene.looks.presence(ranked.noun_phrase, meant_by_names(ranked.answer, scene.names))

        def judged(ranked: Ranked) -> Ranked:
            return with_absence_judged(ranked, scene.names, scene.vocabulary, color_share, presence_by_looks)

        if self._is_plain:
            return tuple(map(judged, self._ranked))
        from fastsplat.service.query.phrases.phrase_answers import (
            AskedScene,
            answer_by_looks,
            answer_phrase,
            answer_surface,
            answer_written,
            closest_kind,
        )

        names = scene.names if scene.names.stored else objects().names
        context = AskedScene(
            names, scene.ranker.names, lambda texts: self._rank(tuple(texts)), lambda: objects().measures, scene.unit,
            scene.written, scene.looks,
        )  # fmt: skip

        def answered(plain: Ranked, phrase: ParsedQuestion | None, parted: ParsedQuestion | None) -> Ranked:
            if names_nothing(plain.answer.text):
                return plain
            if is_foreign(plain.answer.text) and not (phrase and phrase.of_writing):
                return answer_written(plain, context)
            if phrase is None and parted is not None:
                found = answer_phrase(parted, plain, context, asker)
                if found.verdict in ("exact", "possible"):
                    return found
            if phrase is None:
                named = answer_surface(closest_kind(plain, context), context)
                return answer_by_looks(None, answer_written(named, context), context)
            return answer_by_looks(phrase, answer_phrase(phrase, plain, context, asker), context)

        return tuple(judged(answered(*args)) for args in zip(self._ranked, self._parsed, self._parted, strict=True))


class SubscribedQuery:
    """Ranks a repeated query again only for other words, names, versions or days."""

    def __init__(self) -> None:
        self._ranked: RankedQuery | None = None

    def ranked(self, scene: RankedScene, query: TextQuery) -> RankedQuery:
        """Ranks a query to a scene, unless it was the last one."""
        if self._ranked is None or not self._ranked.is_of(scene, query):
            self._ranked = RankedQuery(scene, query)
        return self._ranked
