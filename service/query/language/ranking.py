"""Ranks dictionary entries for texts, without reading Gaussians or rendering."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.language.meaning.calibration import calibration_key
from fastsplat.service.query.language.meaning.common_objects import are_other_objects
from fastsplat.service.query.language.meaning.embeddings import TextCache, TextCaches, text_caches
from fastsplat.service.query.language.meaning.label_meanings import BASE, Comparison, LabelMeanings
from fastsplat.service.query.language.meaning.meaning import MeaningModel, model_for, weighs_meanings
from fastsplat.service.query.language.meaning.probability import (
    Belief,
    believed,
    entry_probability,
    named_belief,
    scored_belief,
)
from fastsplat.service.query.language.meaning.prompt_context import PromptContext, PromptContexts, SceneLabels
from fastsplat.service.query.language.meaning.relevancy import F32, F64, Scores, cosines, relevancy_scores
from fastsplat.service.query.language.words.english import NoQuestion, names_nothing, no_question
from fastsplat.service.query.language.words.judgement import Judgement, Mask, Ranked, Remarks, Verdict
from fastsplat.service.query.language.words.name_matching import NameIndex, NameMatch
from fastsplat.service.query.language.words.noun_phrases import noun_phrase, parse_noun_phrase
from fastsplat.service.query.language.words.query_text import TextQuery
from fastsplat.service.query.objects.absence import RATHER
from fastsplat.service.query.objects.names.object_names import ObjectNames
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat_contract.messages.queries import Answer, AnswerMethod, Match, Relation, RelationSubject

if TYPE_CHECKING:  # onnxruntime loads when it is used
    from fastsplat.service.perception.lexicon.wordnet import Lexicon
    from fastsplat.service.perception.results import TextEncoder


_Related = tuple[Relation, RelationSubject | None]

_STANDING: tuple[_Related, ...] = (("same", None), ("kind_of", "label"))


def text_similarity(
    texts: Sequence[str],
    matches: Sequence[NameMatch],
    labels: F32,
    cache: TextCache,
    templates: Sequence[str] | None = None,
) -> F64:
    """Cosines of Q questions and N entries (unit rows), float64 [Q, N].

    A shared word raises a cosine whatever its role: MiniLM puts "picture of a dog" nearer to "dog" than to "picture".
    So an entry that is only mentioned (`NameMatch.mentions`) is no closer than to the words without it: "wall" is as
    close to "wall clock" as to "clock"."""
    similarity = cosines(cache.embed([noun_phrase(text) for text in texts], templates), labels)
    remainders = list(dict.fromkeys(words for match in matches for words in match.mentions.values()))
    if remainders:
        without_name = dict(zip(remainders, cosines(cache.embed(remainders, templates), labels), strict=True))
        for row, match in enumerate(matches):
            for label_id, words in match.mentions.items():
                entry = label_id - 1
                similarity[row, entry] = min(similarity[row, entry], without_name[words][entry])
    return similarity


RELATED_PROBABILITY = 0.15
"""Least calibrated probability of a relevant entry besides the leading one.

Measured by benchmarks/calibration: 0 shows everything above the threshold, of which every second entry is irrelevant.
"""

_PER_LABEL = 2_048
"""Estimated bytes of a label: names, lookup, count, confidence."""
_FARTHEST = -1.0
"""Score of what a question denies."""


@dataclass(frozen=True)
class _Meant:
    """Result of the meaning model for one question."""

    likely: F64
    presence: float
    comparison: Comparison
    model: MeaningModel


class Ranker:
    """Ranker of one scene's names with one text encoder; thread-safe.

    Args:
        labels: of a scene, with the names of `objects.dictionary`.
        objects: owners of the names; a name neither borne nor suggested answers nothing.
        counts: Gaussians of each label of the scene, 0 first.
        encoder: embeds queries, and labels if the scene's came from another encoder or other templates.
        before: a ranker with the same encoder, settings and lexicon whose meanings are reused.
        lexicon: judges meanings beside the encoder where both were calibrated together; None: not used.
        caches: shared with other scenes; None: those of `before`, or its own.

    Raises:
        ModelUnavailableError: the encoder returns something other than embeddings, or the lexicon's files are
            inconsistent.
    """

    def __init__(
        self,
        labels: SceneLabels,
        objects: ObjectNames,
        counts: Sequence[int],
        encoder: TextEncoder,
        settings: QuerySettings,
        before: Ranker | None = None,
        lexicon: Lexicon | None = None,
        caches: TextCaches | None = None,
    ) -> None:
        self._objects = objects
        self._settings = settings
        self._made_of = labels, counts, encoder, lexicon
        entries, table = labels.dictionary.entries, objects.table
        self._counts = [*counts, *[0] * (1 + len(entries) - len(counts))]
        self._labels = [entry.label for entry in entries]
        ids = range(1, len(entries) + 1)
        self._confidence = np.array([table[i].probability if i in table else 0.0 for i in ids], dtype=np.float64)
        self._present = np.array([i in table for i in ids], dtype=np.bool_)
        self._suggested = np.array([i in table and table[i].suggested for i in ids], dtype=np.bool_)
        self._names = NameIndex(labels.dictionary)
        if caches is None:
            caches = text_caches(encoder, settings) if before is None else before._caches
        self._caches: TextCaches = caches
        self._contexts = PromptContexts(labels, encoder, caches.texts, settings)
        self._model: MeaningModel | None = None
        self._meanings: LabelMeanings | None = None
        if lexicon is not None and weighs_meanings(settings):
            self._model = model_for(calibration_key(encoder.name, encoder.sha256), lexicon.name, settings.templates)
        if lexicon is not None and self._model is not None:
            known = None if before is None else before._meanings
            if known is None or not known.is_of(labels.dictionary):
                known = LabelMeanings(labels.dictionary, lexicon, caches)
            self._meanings = known

    def suggesting(self, objects: ObjectNames) -> Ranker:
        """Returns a ranker of the same scene with more suggested names."""
        labels, counts, encoder, lexicon = self._made_of
        labels = replace(labels, dictionary=objects.dictionary)
        return Ranker(labels, objects, counts, encoder, self._settings, self, lexicon, self._caches)

    @property
    def calibrated(self) -> bool:
        """True if thresholds or a lexicon model exist, so that `related` can be judged."""
        return self._meanings is not None or self._contexts.default.related is not None

    @property
    def nbytes(self) -> int:
        """Estimated bytes in memory, without what it shares."""
        meanings = 0 if self._meanings is None else self._meanings.nbytes
        return self._contexts.nbytes + meanings + _PER_LABEL * len(self._labels)

    @property
    def lexicon(self) -> Lexicon | None:
        return self._made_of[3]

    @property
    def names(self) -> NameIndex:
        return self._names

    def is_name(self, text: str) -> bool:
        """True if the dictionary or the lexicon has the whole text as a name."""
        match = self._names.match(text)
        return bool(match.exact and not match.unchecked) or (
            self._meanings is not None and self._meanings.meaning(text).whole
        )

    def rank(self, query: TextQuery) -> tuple[Ranked, ...]:
        """Ranks the whole dictionary for each text, in order; errors as `PromptContexts.get`."""
        context = self._contexts.get(query.negatives, query.templates)
        matches = [self._names.match(text) for text in query.texts]
        similarity = text_similarity(query.texts, matches, context.entries.labels, self._caches.texts, query.templates)
        scores = relevancy_scores(similarity, context.entries, context.temperature)
        rows = zip(query.texts, matches, map(Scores, scores.similarity, scores.margin, scores.relevancy), strict=True)
        return tuple(self._answer(text, match, context, query.coverage, row) for text, match, row in rows)

    def _answer(self, text: str, match: NameMatch, context: PromptContext, coverage: float, scores: Scores) -> Ranked:
        """Answers one text from scores [N]."""
        by_similarity = self._settings.score == "similarity"
        primary, second = (scores.similarity, scores.margin) if by_similarity else (scores.margin, scores.similarity)
        excluded = self._mask(match.negated) | ~self._present
        primary = np.where(excluded, _FARTHEST, primary)
        # a name that nothing here bears decides nothing
        match = replace(match, exact=tuple(label_id for label_id in match.exact if self._present[label_id - 1]))
        calibration = context.calibration
        meant = self._meant(text, match, context, scores.similarity, excluded)
        comparison: Comparison | None = None
        if meant is not None:
            likely: F64 | None = meant.likely
            judged = self._judge_meaning(match, context, primary, meant)
            primary, second, comparison = meant.likely, scores.similarity, meant.comparison
        else:
            likely = None if calibration is None else entry_probability(primary, calibration)
            judged = self._judge(match, context, primary, likely)
        if names_nothing(text) and not judged.named:
            judged = self._nothing
        belief: Belief | None = None
        if likely is not None and match.exact:
            belief = named_belief(likely, match.exact, self._confidence, coverage)
        elif meant is not None:
            belief = believed(meant.likely, meant.presence, self._confidence, meant.model.scenes, coverage)
        elif calibration is not None and likely is not None:
            belief = scored_belief(primary, likely, self._confidence, calibration, coverage)
        standing = judged.relevant.copy()
        if judged.verdict == "related":
            standing[standing] = [_stands_for(row, match, comparison) for row in np.flatnonzero(standing).tolist()]
        judged = self._without_suggested(judged)
        figures = scores.similarity if by_similarity else scores.relevancy
        figure = figures if belief is None else belief.entries
        order = np.lexsort((np.arange(len(primary)), -second, -primary, -figure, ~judged.relevant))
        nothing = judged.verdict == "absent"
        is_word = None if self._meanings is None else self._meanings.is_word
        unread: NoQuestion = no_question(text, is_word) if nothing else ""
        probability = None
        if belief is not None:
            probability = 1.0 - belief.presence if nothing else float(belief.entries[order[0]])
        if belief is None and judged.suggested and judged.named:
            probability = float(self._confidence[order[0]])  # the very name: language adds no doubt
        doubted = probability is not None and probability < RATHER
        verdict = judged.verdict
        if nothing and (unread or doubted):
            verdict, probability = "undecided", None
        elif judged.suggested or (verdict == "exact" and doubted):
            verdict = "possible"
        said = verdict if verdict != "possible" else judged.verdict
        relation, subject = _answer_relation(said, int(order[0]) if len(order) else -1, match, comparison)
        method: AnswerMethod = "names" if belief is None else "encoder" if meant is None else "lexicon"
        answer = Answer(
            scene_id="",
            text=text,
            probability=probability,
            label_set=() if belief is None else belief.label_set,
            coverage=None if belief is None else coverage,
            version="",
            gaussians=sum(self._counts),
            match_count=len(order),
            matches=self._matches(order, scores, context, judged.relevant, belief),
            masks=(),
            presence=None if belief is None else belief.presence,
            object_ids=self._objects.of_labels((order[judged.relevant[order]] + 1).tolist()),
            searched=self._objects.searched,
            relation=relation,
            relation_subject=subject,
            method=method,
        )
        unchecked = match.unchecked
        if comparison is not None and judged.verdict == "related":
            before = comparison.compounds.before.get(int(order[0]), "")
            unchecked = " ".join(words for words in (before, unchecked) if words)
        ids = np.flatnonzero(standing & judged.relevant) + 1
        compared = context.related is not None or meant is not None
        is_other = meant is None and (judged.verdict, relation) == ("related", "related")
        if is_other:  # encoders alone find objects near that share a room; the lexicon's model weighs kinds itself
            entry = self._made_of[0].dictionary.entries[order[0]]
            is_other = are_other_objects(parse_noun_phrase(text).text, (entry.label, *entry.aliases))
        remarks = Remarks(unchecked, unread, other_object=is_other, calibrated=compared)
        return Ranked(answer, verdict, judged.named, frozenset(ids.tolist()), remarks)

    def _without_suggested(self, judged: Judgement) -> Judgement:
        """Drops suggested names if borne ones remain; else the answer is only possible.

        Meaning is judged as if all names were right: their confidence counts once, in the probability."""
        borne = judged.relevant & ~self._suggested
        if borne.any() or not judged.relevant.any():
            return replace(judged, relevant=borne, leading=judged.leading & borne)
        return replace(judged, suggested=True)

    def _matches(
        self, order: NDArray[np.intp], scores: Scores, context: PromptContext, relevant: Mask, belief: Belief | None
    ) -> tuple[Match, ...]:
        """All entries, best first; built by columns, as there is one for each label."""
        rows = order.tolist()
        columns = zip(
            (order + 1).tolist(),
            [self._labels[row] for row in rows],
            scores.relevancy[order].tolist(),
            scores.similarity[order].tolist(),
            [context.negatives[j] for j in context.entries.nearest_negative[order].tolist()],
            [self._counts[row + 1] for row in rows],
            relevant[order].tolist(),
            [None] * len(rows) if belief is None else belief.entries[order].tolist(),
            strict=True,
        )
        return tuple(map(Match._make, columns))

    def _judge(self, match: NameMatch, context: PromptContext, scores: F64, likely: F64 | None) -> Judgement:
        """Judges by names, scores and thresholds.

        Entries that the question names with further words are shown first, and are never exact."""
        if match.exact:
            exact = self._mask(match.exact)
            return Judgement("exact", exact, exact, named=True)
        negated = self._mask(match.negated)
        exact = (scores >= context.exact) & ~negated
        if exact.any() and not match.heads:
            return Judgement("exact", exact, exact, named=False)
        passing = scores >= (np.inf if context.related is None else context.related)
        related = passing & self._present
        if related.any() and likely is not None:
            related = related & ((likely >= RELATED_PROBABILITY) | (scores == scores.max()))
        leading = self._mask(match.heads) & self._present
        related = (related | leading | self._mask(match.hyponyms)) & ~negated & self._present
        deciding = leading if leading.any() else related
        named = bool(deciding.any()) and not (deciding & passing).any()
        return Judgement("related" if related.any() else "absent", related, leading, named)

    def _meant(
        self, text: str, match: NameMatch, context: PromptContext, similarity: F64, excluded: Mask
    ) -> _Meant | None:
        """Compares the question by the lexicon's model; None if not measured with these prompts."""
        model = self._model
        if self._meanings is None or model is None or context.templates != model.templates:
            return None
        comparison = self._meanings.compare(text, match, similarity)
        logits = model.logits(comparison.columns)
        likely = np.where(excluded, 0.0, model.likely(logits))
        return _Meant(likely, model.presence(logits[~excluded], likely[~excluded]), comparison, model)

    def _judge_meaning(self, match: NameMatch, context: PromptContext, scores: F64, meant: _Meant) -> Judgement:
        """Judges as `_judge`, by the probabilities of the lexicon's model.

        Entries are exact if listed and either share a sense with the whole question or reach the encoder's exact
        threshold. Entries that the question names with further words are shown first all the same."""
        if match.exact:
            exact = self._mask(match.exact)
            return Judgement("exact", exact, exact, named=True)
        comparison, likely = meant.comparison, meant.likely
        found = meant.presence >= meant.model.related
        listed = np.zeros(len(likely), dtype=np.bool_)
        if found and len(likely):
            listed = (likely > 0) & ((likely >= RELATED_PROBABILITY) | (likely == likely.max()))
        shared = (comparison.relations.same > 0) & comparison.meaning.whole
        exact = listed & (shared | (scores >= context.exact))
        if exact.any() and not match.heads:
            return Judgement("exact", exact, exact, named=False)
        leading = self._mask(match.heads) & self._present & ~self._mask(match.negated)
        related = listed | leading
        return Judgement(
            "related" if related.any() else "absent", related, leading, named=bool(leading.any()) and not found
        )

    @property
    def _nothing(self) -> Judgement:
        return Judgement("absent", self._mask(()), self._mask(()), named=False)

    def _mask(self, label_ids: Sequence[int]) -> Mask:
        mask = np.zeros(len(self._labels), dtype=np.bool_)
        mask[np.array(label_ids, dtype=np.intp) - 1] = True
        return mask


def _stands_for(row: int, match: NameMatch, comparison: Comparison | None) -> bool:
    """True if an entry is the object asked for, a synonym or a kind."""
    if row + 1 in (*match.exact, *match.heads):
        return True
    if comparison is not None:
        known_as = comparison.columns[row, BASE.index("known_as")] > 0
        if known_as or (comparison.relations.same[row] > 0 and comparison.meaning.whole):
            return True
    return _answer_relation("related", row, match, comparison) in _STANDING


def _answer_relation(verdict: Verdict, row: int, match: NameMatch, comparison: Comparison | None) -> _Related:
    """Relation of an entry to the question, and the one that is kind or part.

    Grammar precedes the lexicon: "coffee machine" is a kind of machine whether a lexicon has it or not."""
    if verdict == "absent" or verdict == "undecided":
        return verdict, None
    if verdict == "exact":
        return "same", None
    if row + 1 in match.hyponyms:
        return "kind_of", "label"
    if comparison is None:
        return "related", None
    relations = comparison.relations
    if comparison.compounds.same_kind[row]:
        return "kind_of", "question"
    if comparison.compounds.feigned[row] or comparison.compounds.other_name[row]:
        return "related", None
    if not comparison.meaning.whole:  # only the head is known: what is added to it makes a kind of it
        below = relations.same[row] > 0 or relations.narrower[row] > 0
        return ("kind_of", "question") if below else ("related", None)
    if relations.wider[row] > 0:
        return "kind_of", "label"
    if relations.narrower[row] > 0:
        return "kind_of", "question"
    if relations.part[row] > 0:
        return "part_of", "question"
    if relations.whole[row] > 0:
        return "part_of", "label"
    known = dict(zip(BASE, comparison.columns[row].tolist(), strict=True))
    if known["known_kind"]:
        return "kind_of", "label"
    if known["known_below"]:
        return "kind_of", "question"
    return "related", None
