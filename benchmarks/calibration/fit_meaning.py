"""Fit `meaning.json`, the model that weighs what lexicon and text encoder say of a question.

It learns from the dictionaries of `scenes.txt`, `lists.txt` and `compounds.txt`. Every choice (units of the hidden
layer, ridge) and every probability comes from predictions for dictionaries that the model of that fold has not seen:
five folds of whole dictionaries, those that share labels in one (`folds`). What is there counts as much as what is not,
however many questions there are of each, and a label is shown from a presence of a half on: there as large a share of
the one is lost as of the other is let in. Of each question that has an answer there is a second one without it, at a
lower weight: the same words to a dictionary from which the answers were taken, so that the form of a question
("something to ...") says nothing of whether the object is there.
"""

from __future__ import annotations

import datetime
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from benchmarks.absence.questions import ABSENT, COMPOUNDS, FITTED, PRESENT, read_cases
from benchmarks.calibration.folds import folds_of, twin_groups
from benchmarks.calibration.lists import read_scenes
from benchmarks.calibration.separation import auroc, balanced, calibration_error, equal_loss, logistic_fit
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.common.logistic import logistic
from fastsplat.service.perception.lexicon.wordnet import Lexicon
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.query.language.meaning.embeddings import TextCache, TextCaches
from fastsplat.service.query.language.meaning.label_meanings import BASE, LabelMeanings
from fastsplat.service.query.language.meaning.meaning import MeaningModel, expanded, summed_odds
from fastsplat.service.query.language.meaning.probability import Logistic, Nonconformities, candidates, label_set
from fastsplat.service.query.language.ranking import text_similarity
from fastsplat.service.query.language.words.name_matching import NameIndex

F64 = NDArray[np.float64]

_FOLDS = 5
_WITHOUT_ANSWER = 0.3
"""Weight of a question to the rest of its dictionary."""
_PRESENCE, _RANKING = 0.2, 0.1
"""Weights of the presence's and the ranking's losses beside the entries' own."""
_ITERATIONS = 100
_CANDIDATES = ((16, 2e-3),)
"""Hidden units and ridge. 16 and 24 units and ridges of 0.001, 0.002 and 0.004 differ by less than dictionaries do."""
_LIMIT = 5.0
_CACHED_TEXTS = 100_000
_USUAL = ("scenes", *PRESENT, *ABSENT)
"""Lists of what people ask. The others are of hard cases, to learn from; they say nothing of how often such are asked,
so probabilities and the threshold are fitted without them."""
_SHOWN_FROM = 0.5
"""The presence from which on a label is shown: probabilities are fitted so that losses are equal there."""


@dataclass(frozen=True)
class LabelQuestion:
    """One question to one dictionary, with the features of its labels.

    Attributes:
        dictionary: number of the dictionary.
        group: that of the dictionaries that share labels with it, see `twin_groups`.
        fold: of the cross-validation.
        kind: its list, or "scenes".
        base: float64 [N, B], see `LabelMeanings.compare`.
        right: bool [N], labels that answer; none where nothing does.
        judged: bool [N], labels that are either right or wrong; others may stand beside an answer.
    """

    dictionary: int
    group: int
    fold: int
    kind: str
    base: F64
    right: NDArray[np.bool_]
    judged: NDArray[np.bool_]


@dataclass(frozen=True)
class _Net:
    """A fitted model before its probabilities: weights as in `MeaningModel`."""

    mean: F64
    scale: F64
    hidden: F64
    hidden_offset: F64
    output: F64
    offset: float

    def logits(self, base: F64) -> F64:
        features = np.clip((expanded(base) - self.mean) / self.scale, -_LIMIT, _LIMIT)
        return np.asarray(np.tanh(features @ self.hidden + self.hidden_offset) @ self.output + self.offset)


@dataclass(frozen=True)
class _Rows:
    """Labels of all questions, one below the other.

    Attributes:
        features: float64 [R, F], standardized.
        right, weight: float64 [R].
        question: int [R]; `start` int [Q], where each begins; `share` float64 [Q], its weight.
    """

    features: F64
    right: F64
    weight: F64
    question: NDArray[np.intp]
    start: NDArray[np.intp]
    share: F64


def fit_meaning(
    lexicon: Lexicon, cache: TextCache, templates: Sequence[str], report: Callable[[str], None]
) -> MeaningModel:
    """The model of one encoder and lexicon, with the figures of its cross-validation.

    Args:
        lexicon: see `open_lexicon`.
        cache: embeds with the templates.
        templates: of the cache.
        report: gets a line for each candidate.
    """
    examples = questions(lexicon, TextCaches(cache, cache))
    results = []
    for units, ridge in _CANDIDATES:
        logits = _out_of_fold(examples, units, ridge)
        likelihood = _likelihood(examples, logits)
        report(f"{units} units, ridge {ridge:g}: {likelihood:.4f} bits a question")
        results.append((likelihood, units, ridge, logits))
    _, units, ridge, logits = min(results, key=lambda result: result[0])
    net = fit_net(examples, units, ridge)
    model = MeaningModel(
        templates=tuple(templates),
        date=datetime.date.today().isoformat(),
        lexicon=lexicon.name,
        base=BASE,
        mean=_rounded(net.mean),
        scale=_rounded(net.scale),
        hidden=tuple(_rounded(unit) for unit in net.hidden.T),
        hidden_offset=_rounded(net.hidden_offset),
        output=_rounded(net.output),
        offset=round(net.offset, 4),
        **_probabilities(examples, logits),
        scenes=Nonconformities(),
        figures={},
    )
    model = model.model_copy(update={"scenes": _conformal(examples, logits, model)})
    return model.model_copy(update={"figures": {"units": units, "ridge": ridge} | judge(examples, logits, model)})


def compare_templates(
    lexicon: Lexicon,
    encoder: TextEncoder,
    candidates: Sequence[tuple[str, ...]],
    report: Callable[[str], None],
) -> None:
    """Reports, of each of the prompt templates, the figures of the cross-validation, with the same network.

    Raises:
        ModelUnavailableError: as `LabelMeanings`.
    """
    units, ridge = _CANDIDATES[0]
    definitions = TextCache(encoder, ("{}",), _CACHED_TEXTS)
    for templates in candidates:
        examples = questions(lexicon, TextCaches(TextCache(encoder, templates, _CACHED_TEXTS), definitions))
        logits = _out_of_fold(examples, units, ridge)
        present = np.array([example.right.any() for example in examples])
        first = np.array([example.right[int(z.argmax())] for example, z in zip(examples, logits, strict=True)])
        odds = np.array([summed_odds(z) for z in logits])
        positive = odds >= equal_loss(odds[present], odds[~present])
        figures = {
            "templates": templates,
            "bits": round(_likelihood(examples, logits), 4),
            "first_right": round(float(first[present].mean()), 4),
            "found_and_named_at_equal_loss": round(float((positive & first)[present].mean()), 4),
            "auroc": round(auroc(odds[present], odds[~present]), 4),
        }
        report(json.dumps(figures))


def questions(lexicon: Lexicon, caches: TextCaches) -> list[LabelQuestion]:
    """The questions that may be fitted to, without those that a name decides."""
    whole = [
        (scene.name, scene.labels, "scenes", q.query, q.answers, q.also)
        for scene in read_scenes()
        for q in scene.questions
    ]
    whole += [
        (case.scene, case.labels, case.list, case.question, case.answers, ())
        for path in (FITTED, COMPOUNDS)
        for case in read_cases(path)
    ]
    examples: list[LabelQuestion] = []
    dictionaries = [labels for (_, labels), _ in groupby(whole, key=lambda row: row[:2])]
    groups, folds = twin_groups(dictionaries), folds_of(dictionaries, _FOLDS)
    for number, ((_, labels), rows) in enumerate(groupby(whole, key=lambda row: row[:2])):
        dictionary = dictionary_of(labels)
        meanings, names = LabelMeanings(dictionary, lexicon, caches), NameIndex(dictionary)
        embedded = caches.texts.embed(labels)
        for _, _, kind, text, answers, also in rows:
            match = names.match(text)
            if match.exact:
                continue
            similarity = text_similarity([text], [match], embedded, caches.texts)[0]
            base = meanings.compare(text, match, similarity).columns
            right, beside = (np.array([label in these for label in labels]) for these in (answers, also))
            examples.append(LabelQuestion(number, groups[number], folds[number], kind, base, right, ~beside))
    return examples


def fit_net(examples: Sequence[LabelQuestion], units: int, ridge: float) -> _Net:
    """The model that makes these judgements likeliest, by L-BFGS from a fixed start: the same in every run.

    The loss is the entries' cross-entropy, plus that of "anything answers" by the summed odds, plus that of the right
    entries among all by softmax, plus the ridge.
    """
    rows, mean, scale = _rows(examples)
    width = rows.features.shape[1]
    rng = np.random.default_rng(0)
    start = np.concatenate(
        [
            rng.normal(size=width * units) / np.sqrt(width),
            np.zeros(units),
            rng.normal(size=units) / np.sqrt(units),
            [-2.0],
        ]
    )
    present = np.maximum.reduceat(rows.right, rows.start)
    share, total, answered = rows.share, rows.share.sum(), rows.share * present

    def unpacked(weights: F64) -> tuple[F64, F64, F64, float]:
        hidden = weights[: width * units].reshape(width, units)
        return hidden, weights[width * units : -units - 1], weights[-units - 1 : -1], float(weights[-1])

    def loss(weights: F64) -> tuple[float, F64]:
        hidden, hidden_offset, output, offset = unpacked(weights)
        layer = np.tanh(rows.features @ hidden + hidden_offset)
        z = layer @ output + offset
        value = (rows.weight * (np.logaddexp(0.0, z) - rows.right * z)).sum() / rows.weight.sum()
        slope = rows.weight * (logistic(z) - rows.right) / rows.weight.sum()
        most = np.maximum.reduceat(z, rows.start)
        odds = np.exp(z - most[rows.question])
        whole = np.add.reduceat(odds, rows.start)
        summed, softmax = most + np.log(whole), odds / whole[rows.question]
        value += _PRESENCE * (share * (np.logaddexp(0.0, summed) - present * summed)).sum() / total
        slope += _PRESENCE * (share * (logistic(summed) - present))[rows.question] * softmax / total
        good = np.add.reduceat(odds * rows.right, rows.start)
        good = np.where(present > 0, good, 1.0)
        value -= _RANKING * (answered * np.log(good / whole)).sum() / answered.sum()
        among = odds * rows.right / good[rows.question]
        slope -= _RANKING * answered[rows.question] * (among - softmax) / answered.sum()
        value += 0.5 * ridge * float((hidden**2).sum() + (output**2).sum())
        inner = np.outer(slope, output) * (1.0 - layer * layer)
        gradient = [
            (rows.features.T @ inner + ridge * hidden).ravel(),
            inner.sum(axis=0),
            layer.T @ slope + ridge * output,
            [slope.sum()],
        ]
        return value, np.concatenate(gradient)

    optimum = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": _ITERATIONS})
    return _Net(mean, scale, *unpacked(optimum.x))


def _rows(examples: Sequence[LabelQuestion]) -> tuple[_Rows, F64, F64]:
    features, right, weight, share, sizes = [], [], [], [], []
    for example in examples:
        wrong = example.judged & ~example.right
        parts = [(example.judged, 1.0)]
        if example.right.any() and wrong.sum() >= 3:
            parts.append((wrong, _WITHOUT_ANSWER))
        for there, mass in parts:  # leads are within the labels that are there
            features.append(expanded(example.base[there]))
            right.append(example.right[there].astype(np.float64))
            weight.append(np.full(int(there.sum()), mass))
            share.append(mass)
            sizes.append(int(there.sum()))
    stacked = np.concatenate(features)
    mean, scale = np.round(stacked.mean(axis=0), 4), np.round(stacked.std(axis=0) + 1e-3, 4)
    standardized = np.clip((stacked - mean) / scale, -_LIMIT, _LIMIT)
    start = np.cumsum([0, *sizes])[:-1].astype(np.intp)
    question = np.repeat(np.arange(len(sizes)), sizes)
    rows = _Rows(standardized, np.concatenate(right), np.concatenate(weight), question, start, np.array(share))
    return rows, mean, scale


def _out_of_fold(examples: Sequence[LabelQuestion], units: int, ridge: float) -> list[F64]:
    """The logits of each question by a model that has not seen its dictionary."""
    logits: list[F64] = [np.zeros(0)] * len(examples)
    for fold in range(_FOLDS):
        net = fit_net([example for example in examples if example.fold != fold], units, ridge)
        for place, example in enumerate(examples):
            if example.fold == fold:
                logits[place] = net.logits(example.base)
    return logits


def _likelihood(examples: Sequence[LabelQuestion], logits: Sequence[F64]) -> float:
    """Bits a question by which the odds Σ exp(logits) : 1 miss what is true: the right labels, or nothing."""
    bits = []
    for example, z in zip(examples, logits, strict=True):
        rows = example.judged
        whole = np.logaddexp(0.0, summed_odds(z[rows]))
        bits.append(whole - (summed_odds(z[example.right]) if example.right.any() else 0.0))
    return float(np.mean(bits) / np.log(2.0))


def _probabilities(examples: Sequence[LabelQuestion], logits: Sequence[F64]) -> dict[str, Any]:
    """Platt's scaling of the leading label and of the presence, and the presence from which on a label is shown."""
    usual = [(example, z) for example, z in zip(examples, logits, strict=True) if example.kind in _USUAL]
    examples, logits = [example for example, _ in usual], [z for _, z in usual]
    present = np.array([example.right.any() for example in examples])
    first = np.array([example.right[int(z.argmax())] for example, z in zip(examples, logits, strict=True)])
    weights = balanced(present)
    entry = _platt(np.array([z.max() for z in logits]), first, weights)
    here = _platt(np.array([summed_odds(z) for z in logits]), present, weights)
    presence = np.maximum(
        [entry.score * z.max() + entry.offset for z in logits],
        [here.score * summed_odds(z) + here.offset for z in logits],
    )
    apart = equal_loss(presence[present], presence[~present])  # of log-odds: 0 but for what the fit leaves
    moved = [scaling.model_copy(update={"offset": round(scaling.offset - apart, 4)}) for scaling in (entry, here)]
    return {"entry": moved[0], "present": moved[1], "related": _SHOWN_FROM}


def _platt(scores: F64, truth: NDArray[np.bool_], weights: F64) -> Logistic:
    score, offset = logistic_fit(scores[:, None], truth, weights)
    return Logistic(score=score, offset=offset)


def _conformal(
    examples: Sequence[LabelQuestion], logits: Sequence[F64], model: MeaningModel, without: int | None = None
) -> Nonconformities:
    """By dictionary of `lists.txt` and `compounds.txt`, whose questions are the harder ones, the nonconformity of each
    question's best acceptable answer; without those of the group `without`."""
    present: dict[int, list[float]] = {}
    absent: dict[int, list[float]] = {}
    for example, z in zip(examples, logits, strict=True):
        if example.kind == "scenes" or example.group == without:
            continue
        values = _nonconformities(z, model)
        if example.right.any():
            present.setdefault(example.dictionary, []).append(round(float(values[1:][example.right].min()), 4))
        else:
            absent.setdefault(example.dictionary, []).append(round(float(values[0]), 4))
    return Nonconformities(present=tuple(map(tuple, present.values())), absent=tuple(map(tuple, absent.values())))


def _nonconformities(logits: F64, model: MeaningModel) -> F64:
    likely = model.likely(logits)
    return candidates(likely, model.presence(logits, likely))


def judge(examples: Sequence[LabelQuestion], logits: Sequence[F64], model: MeaningModel) -> dict[str, Any]:
    """Figures of the cross-validation, of all lists and each; label sets by bounds without the dictionary's twins."""
    present = np.array([example.right.any() for example in examples])
    first = np.array([example.right[int(z.argmax())] for example, z in zip(examples, logits, strict=True)])
    likely = [model.likely(z) for z in logits]
    presence = np.array([model.presence(z, p) for z, p in zip(logits, likely, strict=True)])
    weights = balanced(present)
    positive = presence >= model.related
    right = np.where(present, positive & first, ~positive)
    bounds = {
        group: _conformal(examples, logits, model, group).bounds(0.9)
        for group in {example.group for example in examples}
    }
    covered: dict[bool, list[bool]] = {True: [], False: []}
    sizes = []
    for example, z in zip(examples, logits, strict=True):
        if example.kind == "scenes":
            continue
        members = label_set(_nonconformities(z, model), bounds[example.group])
        truth = set((np.flatnonzero(example.right) + 1).tolist()) or {0}
        covered[bool(example.right.any())].append(bool(truth & set(members)))
        sizes.append(sum(label_id > 0 for label_id in members))
    kinds = np.array([example.kind for example in examples])
    usual = np.isin(kinds, _USUAL)
    figures = {
        "dictionaries": len({example.dictionary for example in examples}),
        "groups": len({example.group for example in examples}),
        "questions": len(examples),
        "found": float(positive[present].mean()),
        "usual_found": float(positive[present & usual].mean()),
        "usual_found_and_named": float(right[present & usual].mean()),
        "usual_rightly_absent": float(right[~present & usual].mean()),
        "found_and_named": float(right[present].mean()),
        "rightly_absent": float(right[~present].mean()),
        "auroc": auroc(presence[present], presence[~present]),
        "leading_ece": calibration_error(np.array([p.max() for p in likely]), first.astype(np.float64), weights),
        "presence_ece": calibration_error(presence, present.astype(np.float64), weights),
        "label_sets_covered_present": float(np.mean(covered[True])),
        "label_sets_covered_absent": float(np.mean(covered[False])),
        "label_sets_size": float(np.mean(sizes)),
    }
    figures |= {f"right_{kind}": float(right[kinds == kind].mean()) for kind in sorted(set(kinds.tolist()))}
    return {name: round(value, 4) for name, value in figures.items()}


def _rounded(values: F64) -> tuple[float, ...]:
    return tuple(round(float(value), 4) for value in values)
