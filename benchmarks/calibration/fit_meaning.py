"""Fit the model that weighs what lexicon and text encoder say of a question and a label: `service/query/meaning.json`.

It learns from the dictionaries of `scenes.txt`, `lists.txt` and `compounds.txt`. Every choice (units of the hidden
layer, ridge) and every probability comes from predictions for dictionaries that the model of that fold has not seen:
five folds of whole dictionaries. Of each question that has an answer there is a second one without it, at a lower
weight: the same words to a dictionary from which the answers were taken, so that the form of a question ("something to
...") says nothing of whether the thing is there.
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

from benchmarks.absence.questions import COMPOUNDS, FITTED, read_cases
from benchmarks.calibration.lists import read_scenes
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.perception.lexicon import Lexicon
from fastsplat.service.perception.text import TextEncoder
from fastsplat.service.query.embeddings import TextCache, TextCaches
from fastsplat.service.query.label_meanings import BASE, LabelMeanings
from fastsplat.service.query.meaning import MeaningModel, expanded, summed_odds
from fastsplat.service.query.name_matching import NameIndex
from fastsplat.service.query.probability import Logistic, candidates, label_set, nonconformity_bound
from fastsplat.service.query.relevancy import logistic
from fastsplat.service.query.text_similarity import text_similarity

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
_ABSENT_SHARE = 0.9
"""Of the absent questions, the share that is to be said to be absent: who is shown something else is misled."""


@dataclass(frozen=True)
class Asked:
    """One question to one dictionary, with the features of its labels.

    Attributes:
        dictionary: number of the dictionary.
        kind: its list, or "scenes".
        base: float64 [N, B], see `LabelMeanings.compare`.
        right: bool [N], labels that answer; none where nothing does.
        judged: bool [N], labels that are either right or wrong; others may stand beside an answer.
    """

    dictionary: int
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
    asked = questions(lexicon, TextCaches(cache, cache))
    results = []
    for units, ridge in _CANDIDATES:
        logits = _out_of_fold(asked, units, ridge)
        likelihood = _likelihood(asked, logits)
        report(f"{units} units, ridge {ridge:g}: {likelihood:.4f} bits a question")
        results.append((likelihood, units, ridge, logits))
    _, units, ridge, logits = min(results, key=lambda result: result[0])
    net = fit_net(asked, units, ridge)
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
        **_probabilities(asked, logits),
        scenes=(),
        figures={},
    )
    model = model.model_copy(update={"scenes": _conformal(asked, logits, model)})
    return model.model_copy(update={"figures": {"units": units, "ridge": ridge} | judge(asked, logits, model)})


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
        asked = questions(lexicon, TextCaches(TextCache(encoder, templates, _CACHED_TEXTS), definitions))
        logits = _out_of_fold(asked, units, ridge)
        present = np.array([each.right.any() for each in asked])
        first = np.array([each.right[int(z.argmax())] for each, z in zip(asked, logits, strict=True)])
        odds = np.array([summed_odds(z) for z in logits])
        from benchmarks.calibration.calibrate import auroc

        shown = odds > np.quantile(odds[~present], _ABSENT_SHARE)
        figures = {
            "templates": templates,
            "bits": round(_likelihood(asked, logits), 4),
            "first_right": round(float(first[present].mean()), 4),
            "found_and_named_at_0.9_absent": round(float((shown & first)[present].mean()), 4),
            "auroc": round(auroc(odds[present], odds[~present]), 4),
        }
        report(json.dumps(figures))


def questions(lexicon: Lexicon, caches: TextCaches) -> list[Asked]:
    """The questions that may be fitted to, without those that a name decides."""
    whole = [
        (scene.name, scene.labels, "scenes", q.query, q.answers, q.also) for scene in read_scenes() for q in scene.asked
    ]
    whole += [
        (case.scene, case.labels, case.list, case.question, case.answers, ())
        for path in (FITTED, COMPOUNDS)
        for case in read_cases(path)
    ]
    asked: list[Asked] = []
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
            asked.append(Asked(number, kind, base, right, ~beside))
    return asked


def fit_net(asked: Sequence[Asked], units: int, ridge: float) -> _Net:
    """The model that makes these judgements likeliest, by L-BFGS from a fixed start: the same in every run.

    The loss is the entries' cross-entropy, plus that of "anything answers" by the summed odds, plus that of the right
    entries among all by softmax, plus the ridge.
    """
    rows, mean, scale = _rows(asked)
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


def _rows(asked: Sequence[Asked]) -> tuple[_Rows, F64, F64]:
    features, right, weight, share, sizes = [], [], [], [], []
    for each in asked:
        wrong = each.judged & ~each.right
        parts = [(each.judged, 1.0)]
        if each.right.any() and wrong.sum() >= 3:
            parts.append((wrong, _WITHOUT_ANSWER))
        for there, mass in parts:  # leads are within the labels that are there
            features.append(expanded(each.base[there]))
            right.append(each.right[there].astype(np.float64))
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


def _out_of_fold(asked: Sequence[Asked], units: int, ridge: float) -> list[F64]:
    """The logits of each question by a model that has not seen its dictionary."""
    logits: list[F64] = [np.zeros(0)] * len(asked)
    for fold in range(_FOLDS):
        net = fit_net([each for each in asked if each.dictionary % _FOLDS != fold], units, ridge)
        for place, each in enumerate(asked):
            if each.dictionary % _FOLDS == fold:
                logits[place] = net.logits(each.base)
    return logits


def _likelihood(asked: Sequence[Asked], logits: Sequence[F64]) -> float:
    """Bits a question by which the odds Σ exp(logits) : 1 miss what is true: the right labels, or nothing."""
    bits = []
    for each, z in zip(asked, logits, strict=True):
        rows = each.judged
        whole = np.logaddexp(0.0, summed_odds(z[rows]))
        bits.append(whole - (summed_odds(z[each.right]) if each.right.any() else 0.0))
    return float(np.mean(bits) / np.log(2.0))


def _probabilities(asked: Sequence[Asked], logits: Sequence[F64]) -> dict[str, Any]:
    """Platt's scaling of the leading label and of the presence, and the presence from which on a label is shown: the
    lowest at which `_ABSENT_SHARE` of the absent questions are said to be absent."""
    present = np.array([each.right.any() for each in asked])
    first = np.array([each.right[int(z.argmax())] for each, z in zip(asked, logits, strict=True)])
    entry = _platt(np.array([z.max() for z in logits]), first)
    here = _platt(np.array([summed_odds(z) for z in logits]), present)
    model = [
        max(
            float(logistic(np.array(here.score * summed_odds(z) + here.offset))),
            float(logistic(np.array(entry.score * z.max() + entry.offset))),
        )
        for z in logits
    ]
    presence = np.array(model)
    related = float(np.ceil(1e4 * np.quantile(presence[~present], _ABSENT_SHARE, method="higher"))) / 1e4
    return {"entry": entry, "present": here, "related": related}


def _platt(scores: F64, truth: NDArray[np.bool_]) -> Logistic:
    sign = np.where(truth, 1.0, -1.0)
    optimum = minimize(
        lambda w: np.logaddexp(0.0, -sign * (w[0] * scores + w[1])).mean(), np.array([1.0, 0.0]), method="BFGS"
    )
    return Logistic(score=round(float(optimum.x[0]), 4), offset=round(float(optimum.x[1]), 4))


def _conformal(asked: Sequence[Asked], logits: Sequence[F64], model: MeaningModel) -> tuple[tuple[float, ...], ...]:
    """By dictionary of `lists.txt`, whose questions are the harder ones, the nonconformity of each question's best
    acceptable answer."""
    by_dictionary: dict[int, list[float]] = {}
    for each, z in zip(asked, logits, strict=True):
        if each.kind == "scenes":
            continue
        values = _nonconformities(z, model)
        best = values[1:][each.right].min() if each.right.any() else values[0]
        by_dictionary.setdefault(each.dictionary, []).append(round(float(best), 4))
    return tuple(tuple(values) for values in by_dictionary.values())


def _nonconformities(logits: F64, model: MeaningModel) -> F64:
    likely = model.likely(logits)
    return candidates(likely, model.presence(logits, likely))


def judge(asked: Sequence[Asked], logits: Sequence[F64], model: MeaningModel) -> dict[str, Any]:
    """Figures of the cross-validation, all lists and each list; label sets by bounds that leave a dictionary out."""
    from benchmarks.calibration.calibrate import auroc, calibration_error

    present = np.array([each.right.any() for each in asked])
    first = np.array([each.right[int(z.argmax())] for each, z in zip(asked, logits, strict=True)])
    likely = [model.likely(z) for z in logits]
    presence = np.array([model.presence(z, p) for z, p in zip(logits, likely, strict=True)])
    shown = presence >= model.related
    right = np.where(present, shown & first, ~shown)
    covered, sizes = [], []
    dictionaries = sorted({each.dictionary for each in asked if each.kind != "scenes"})
    for each, z in zip(asked, logits, strict=True):
        if each.kind == "scenes":
            continue
        others = tuple(s for d, s in zip(dictionaries, model.scenes, strict=True) if d != each.dictionary)
        chosen = label_set(_nonconformities(z, model), nonconformity_bound(others, 0.9))
        truth = set((np.flatnonzero(each.right) + 1).tolist()) or {0}
        covered.append(bool(truth & set(chosen)))
        sizes.append(sum(label_id > 0 for label_id in chosen))
    kinds = np.array([each.kind for each in asked])
    figures = {
        "dictionaries": len({each.dictionary for each in asked}),
        "questions": len(asked),
        "found_and_named": float(right[present].mean()),
        "rightly_absent": float(right[~present].mean()),
        "auroc": auroc(presence[present], presence[~present]),
        "leading_ece": calibration_error(np.array([p.max() for p in likely]), first.astype(np.float64)),
        "presence_ece": calibration_error(presence, present.astype(np.float64)),
        "label_sets_covered": float(np.mean(covered)),
        "label_sets_size": float(np.mean(sizes)),
    }
    figures |= {f"right_{kind}": float(right[kinds == kind].mean()) for kind in sorted(set(kinds.tolist()))}
    return {name: round(value, 4) for name, value in figures.items()}


def _rounded(values: F64) -> tuple[float, ...]:
    return tuple(round(float(value), 4) for value in values)
