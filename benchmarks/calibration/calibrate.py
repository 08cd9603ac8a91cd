"""Measure what a text encoder's scores mean, and write it down for the query room.

    python -m benchmarks.calibration.calibrate --models DIR [--encoder NAME] [--templates] [--lexicon NAME] [--dry-run]

Thresholds come from `pairs.txt`; every other label sets them, the remaining ones and the dictionaries of `scenes.txt`
judge them:
  related: the score that one in a hundred absent pairs reaches, because a dictionary asks that question once per entry;
  exact: the highest score that a pair which is not exact reaches, because an encoder of sentences puts "toast" as near
    to "toaster" as another name of it.
Probabilities and label sets come from `scenes.txt`, by scene: of four in a row, the first fits the two logistic models
(Platt's scaling) and the temperature, the second and third give the conformal scores, the fourth judges.
`--templates` compares prompt templates and both scores instead of writing anything, on the scenes that do not judge, so
that what is chosen by them is judged by scenes that chose nothing. `--lexicon wordnet` fits what weighs lexicon and
encoder instead, see `fit_meaning`; with `--templates` it compares those for this model, by cross-validation.
"""

from __future__ import annotations

import argparse
import datetime
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from benchmarks.calibration.fit_meaning import compare_templates, fit_meaning
from benchmarks.calibration.lists import Pair, Questions, read_pairs, read_scenes
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.perception.lexicon import open_lexicon
from fastsplat.service.perception.text import TextEncoder, open_text_encoder
from fastsplat.service.query.calibration import FILE, Score, calibration_key
from fastsplat.service.query.embeddings import TextCache
from fastsplat.service.query.meaning import FILE as MEANING_FILE
from fastsplat.service.query.name_matching import NameIndex, NameMatch
from fastsplat.service.query.probability import (
    Logistic,
    ScoreCalibration,
    candidates,
    entry_probability,
    label_set,
    leads,
    nonconformity_bound,
    present_probability,
)
from fastsplat.service.query.relevancy import entries, relevancy_scores
from fastsplat.service.query.settings import QuerySettings
from fastsplat.service.query.text_similarity import text_similarity

F64 = NDArray[np.float64]
_ABSENT_RATE = 0.01
_COVERAGES = (0.5, 0.8, 0.9, 0.95)
_CANDIDATES: tuple[tuple[str, ...], ...] = (
    ("{}",),
    ("a {}",),
    ("a photo of a {}",),
    ("{}", "a photo of a {}"),
    ("{}", "a {}", "a photo of a {}"),
)


@dataclass(frozen=True)
class ScoredQuestion:
    """One question with its scores: `first` and `also` are rows of the dictionary; `named` if the hash table knows the
    name, so that the scores decide nothing."""

    scene: int
    where: str
    labels: tuple[str, ...]
    query: str
    scores: F64
    first: tuple[int, ...]
    also: tuple[int, ...]
    named: bool


def measure(
    encoder: TextEncoder, templates: Sequence[str], negatives: Sequence[str], *, choosing: bool = False
) -> dict[Score, tuple[ScoreCalibration, dict[str, Any]]]:
    """By score: what the product needs, and the figures it reaches on what did not set it.

    `choosing` leaves the scenes out that judge, and divides the others among the same tasks.
    """
    cache = TextCache(encoder, templates, 100_000)
    embedded = cache.embed(negatives)
    pairs = read_pairs()
    names: tuple[Score, ...] = ("similarity", "relevancy")
    scenes = [scene for number, scene in enumerate(read_scenes()) if not (choosing and number % 4 == 3)]
    results: dict[Score, tuple[ScoreCalibration, dict[str, Any]]] = {}
    for name in names:
        values = np.array(
            [_scores(name, cache, [pair.label], [pair.query], [NameMatch()], embedded)[0, 0] for pair in pairs]
        )
        related, exact, figures = _thresholds(pairs, values)
        questions = ask_scenes(name, cache, embedded, scenes)
        margins = questions if name == "relevancy" else ask_scenes("relevancy", cache, embedded, scenes)
        temperature = _temperature(margins)
        calibration = fit(questions, related, exact, temperature)
        results[name] = (calibration, figures | judge(questions, calibration))
    return results


def ask_scenes(
    name: Score, cache: TextCache, negatives: NDArray[np.float32], scenes: Sequence[Questions] | None = None
) -> list[ScoredQuestion]:
    """Every question of the scenes, by default those of `scenes.txt`, with its scores; `negatives` are embedded."""
    return [
        question
        for number, scene in enumerate(read_scenes() if scenes is None else scenes)
        for question in _ask(name, number, scene, cache, negatives)
    ]


def fit(questions: Sequence[ScoredQuestion], related: float, exact: float, temperature: float) -> ScoreCalibration:
    """The logistic models from every fourth scene, the conformal scores from the two that follow it."""
    fitting = [question for question in questions if question.scene % 4 == 0 and not question.named]
    best = np.array([question.scores.max() for question in fitting])
    present = _logistic(best[:, None], np.array([bool(question.first) for question in fitting]))
    background = round(float(np.median(best[[not question.first for question in fitting]])), 4)
    features, accepted = [], []
    for question in fitting:
        judged = [row for row in range(len(question.labels)) if row not in question.also]
        features.append(np.stack([question.scores, leads(question.scores, background)], axis=1)[judged])
        accepted += [row in question.first for row in judged]
    entry = _logistic(np.concatenate(features), np.array(accepted))
    models = ScoreCalibration(
        related=round(related, 4),
        exact=round(exact, 4),
        entry=Logistic(score=entry[0], lead=entry[1], offset=entry[2]),
        present=Logistic(score=present[0], offset=present[1]),
        background=background,
        temperature=temperature,
        scenes=(),
    )
    return models.model_copy(update={"scenes": conformal_scenes(questions, models, (1, 2))})


def _temperature(questions: Sequence[ScoredQuestion]) -> float:
    """The t of σ(t·margin) that makes the fitting scenes' judgements likeliest; `questions` hold margins."""
    signed = [
        (margin if row in question.first else -margin)
        for question in questions
        if question.scene % 4 == 0 and not question.named
        for row, margin in enumerate(question.scores.tolist())
        if row not in question.also
    ]
    optimum = minimize_scalar(
        lambda t: np.logaddexp(0.0, -t * np.array(signed)).mean(), bounds=(0, 1000), method="bounded"
    )
    return round(float(optimum.x), 2)


def conformal_scenes(
    questions: Sequence[ScoredQuestion], models: ScoreCalibration, quarters: Sequence[int]
) -> tuple[tuple[float, ...], ...]:
    """By scene, the nonconformity of each question's best acceptable answer; none where a name decides."""
    by_scene: dict[int, list[float]] = {}
    for question in questions:
        if question.scene % 4 in quarters and not question.named:
            values = nonconformities(question, models)
            by_scene.setdefault(question.scene, []).append(round(min(values[row] for row in acceptable(question)), 5))
    return tuple(tuple(values) for values in by_scene.values())


def nonconformities(question: ScoredQuestion, models: ScoreCalibration) -> F64:
    """float64 [N + 1], see `candidates`."""
    entry = entry_probability(question.scores, models)
    return candidates(entry, float(present_probability(question.scores, entry, models)))


def acceptable(question: ScoredQuestion) -> set[int]:
    """Label ids that answer; 0 for what is not there."""
    return {row + 1 for row in question.first} or {0}


def judge(questions: Sequence[ScoredQuestion], calibration: ScoreCalibration) -> dict[str, Any]:
    """Figures on the scenes that fitted nothing."""
    scored = [question for question in questions if not question.named]
    judges = [question for question in scored if question.scene % 4 == 3]
    accepted, entry_p, top_right, top_p, here, here_p = [], [], [], [], [], []
    for question in judges:
        entry = entry_probability(question.scores, calibration)
        judged = [row for row in range(len(entry)) if row not in question.also]
        accepted += [row in question.first for row in judged]
        entry_p += entry[judged].tolist()
        top = int(question.scores.argmax())
        top_right.append(top in question.first)
        top_p.append(float(entry[top]))
        here.append(bool(question.first))
        here_p.append(float(present_probability(question.scores, entry, calibration)))
    figures: dict[str, Any] = {
        "scenes": len({question.scene for question in scored}),
        "questions": len(scored),
        "questions_judging_probabilities": len(judges),
    }
    for name, truth, probability in (
        ("entry", accepted, entry_p),
        ("leading_entry", top_right, top_p),
        ("present", here, here_p),
    ):
        p, y = np.array(probability), np.array(truth, dtype=float)
        figures[f"{name}_brier"] = round(float(((p - y) ** 2).mean()), 4)
        figures[f"{name}_brier_of_base_rate"] = round(float(y.mean() * (1 - y.mean())), 4)
        figures[f"{name}_ece"] = round(calibration_error(p, y), 4)
    for coverage in _COVERAGES:
        bound = nonconformity_bound(calibration.scenes, coverage)
        sets = [label_set(nonconformities(question, calibration), bound) for question in judges]
        covered = [bool(acceptable(question) & set(chosen)) for question, chosen in zip(judges, sets, strict=True)]
        figures[f"label_sets_{coverage}"] = {
            "covered": round(float(np.mean(covered)), 4),
            "mean_size": round(float(np.mean([len(chosen) for chosen in sets])), 2),
        }
    share = QuerySettings().related_probability
    return (
        figures
        | _listed(scored, calibration, 0.0, "listed_by_threshold")
        | _listed(scored, calibration, share, "listed")
    )


def _listed(scored: Sequence[ScoredQuestion], calibration: ScoreCalibration, share: float, name: str) -> dict[str, Any]:
    """How well the relevant entries are chosen: found, named, absent, and precision and recall of the lists."""
    present = [question for question in scored if question.first]
    absent = [question for question in scored if not question.first]
    lists = {
        id(question): related_rows(question.scores, entry_probability(question.scores, calibration), calibration, share)
        for question in scored
    }
    shown = [(row, question) for question in present for row in np.flatnonzero(lists[id(question)]).tolist()]
    welcome = sum(row in question.first or row in question.also for row, question in shown)
    acceptable_rows = sum(len(question.first) for question in present)
    hit = sum(bool(lists[id(question)][row]) for question in present for row in question.first)
    best = np.array([question.scores.max() for question in present])
    best_absent = np.array([question.scores.max() for question in absent])
    return {
        name: {
            "found": f"{sum(bool(lists[id(question)].any()) for question in present)}/{len(present)}",
            "named_rightly": f"{sum(int(q.scores.argmax()) in q.first for q in present if lists[id(q)].any())}"
            f"/{len(present)}",
            "rightly_absent": f"{sum(not lists[id(question)].any() for question in absent)}/{len(absent)}",
            "auroc_present_against_absent": round(auroc(best, best_absent), 4),
            "precision": round(welcome / max(len(shown), 1), 4),
            "recall": round(hit / acceptable_rows, 4),
            "entries_an_answer": round(len(shown) / len(present), 2),
        }
    }


def related_rows(scores: F64, entry: F64, calibration: ScoreCalibration, share: float) -> NDArray[np.bool_]:
    """The rule of the product, `service.query.ranking`: above the threshold, and likely enough unless it leads."""
    return (scores >= calibration.related) & ((entry >= share) | (scores == scores.max()))


def _thresholds(pairs: Sequence[Pair], values: F64) -> tuple[float, float, dict[str, Any]]:
    kinds = np.array([pair.kind for pair in pairs])
    sets = np.array([pair.sets for pair in pairs])
    related_from = float(np.quantile(values[sets & (kinds == "absent")], 1 - _ABSENT_RATE))
    exact_from = float(np.nextafter(values[sets & (kinds != "exact")].max(), np.inf))
    exact, related, absent = (values[~sets & (kinds == kind)] for kind in ("exact", "related", "absent"))
    right = (np.concatenate([exact, related]) >= related_from).sum() + (absent < related_from).sum()
    return (
        related_from,
        exact_from,
        {
            "pairs_held_out": int((~sets).sum()),
            "auroc_related_against_absent": round(auroc(related, absent), 4),
            "auroc_exact_against_rest": round(auroc(exact, np.concatenate([related, absent])), 4),
            "accuracy_related_or_exact_against_absent": round(float(right) / int((~sets).sum()), 4),
            "related_recall": round(float((related >= related_from).mean()), 4),
            "absent_false_positives": round(float((absent >= related_from).mean()), 4),
            "exact_recall": round(float((exact >= exact_from).mean()), 4),
            "exact_false_positives": round(float((np.concatenate([related, absent]) >= exact_from).mean()), 4),
        },
    )


def _ask(
    name: Score, number: int, scene: Questions, cache: TextCache, negatives: NDArray[np.float32]
) -> list[ScoredQuestion]:
    texts = [question.query for question in scene.asked]
    matches = [NameIndex(dictionary_of(scene.labels)).match(text) for text in texts]
    rows = _scores(name, cache, scene.labels, texts, matches, negatives)
    return [
        ScoredQuestion(
            number,
            scene.name,
            scene.labels,
            question.query,
            row,
            tuple(scene.labels.index(answer) for answer in question.answers),
            tuple(scene.labels.index(answer) for answer in question.also),
            bool(match.exact),
        )
        for question, match, row in zip(scene.asked, matches, rows, strict=True)
    ]


def _scores(
    name: Score,
    cache: TextCache,
    labels: Sequence[str],
    texts: Sequence[str],
    matches: Sequence[NameMatch],
    negatives: NDArray[np.float32],
) -> F64:
    """float64 [Q, N], as the product scores them."""
    dictionary = entries(cache.embed(labels), negatives)
    similarity = text_similarity(texts, matches, dictionary.labels, cache)
    scores = relevancy_scores(similarity, dictionary, 1.0)
    return scores.similarity if name == "similarity" else scores.margin


def _logistic(features: F64, truth: NDArray[np.bool_]) -> list[float]:
    """Weights and offset of the logistic regression of truth [R] on features [R, F], by maximum likelihood with a
    ridge so weak that it only matters where the classes separate."""
    columns = np.column_stack([features, np.ones(len(features))])
    sign = np.where(truth, 1.0, -1.0)

    def loss(weights: F64) -> float:
        ridge = 1e-3 * float((weights[:-1] ** 2).sum()) / len(columns)
        return float(np.logaddexp(0.0, -sign * (columns @ weights)).mean()) + ridge

    optimum = minimize(loss, np.zeros(columns.shape[1]), method="BFGS")
    return [round(float(weight), 3) for weight in optimum.x]


def calibration_error(probability: F64, truth: F64, bins: int = 10) -> float:
    """Expected calibration error over bins of equal count."""
    order = probability.argsort()
    parts = np.array_split(order, bins)
    return float(
        sum(abs(probability[part].mean() - truth[part].mean()) * len(part) for part in parts) / len(probability)
    )


def auroc(positive: F64, negative: F64) -> float:
    """Probability that a positive scores above a negative, ties half."""
    difference = positive[:, None] - negative[None, :]
    return float((difference > 0).mean() + 0.5 * (difference == 0).mean())


def _written(entry: dict[str, Any]) -> str:
    """JSON with lists of numbers on one line."""
    text = json.dumps(entry, indent=1, ensure_ascii=False, sort_keys=True)
    return re.sub(r"\[\s+(-?\d[^\[\]]*?)\s+\]", lambda match: "[" + " ".join(match.group(1).split()) + "]", text)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", type=Path, required=True, help="model directory")
    parser.add_argument("--encoder", default="minilm_l6_int8", help="text encoder of the model manifest")
    parser.add_argument("--templates", action="store_true", help="compare prompt templates, write nothing")
    parser.add_argument("--lexicon", default="", help="fit the model of this lexicon and the encoder")
    parser.add_argument("--dry-run", action="store_true", help="print, write nothing")
    arguments = parser.parse_args()
    encoder = open_text_encoder(arguments.encoder, arguments.models)
    settings = QuerySettings()
    if arguments.lexicon and arguments.templates:
        compare_templates(open_lexicon(arguments.lexicon, arguments.models), encoder, _CANDIDATES, print)
        return
    if arguments.lexicon:
        cache = TextCache(encoder, settings.templates, 100_000)
        model = fit_meaning(open_lexicon(arguments.lexicon, arguments.models), cache, settings.templates, print)
        print(_written({**model.figures}))
        if not arguments.dry_run:
            _write(MEANING_FILE, calibration_key(encoder.name, encoder.sha256), model.model_dump())
        return
    if arguments.templates:
        for templates in _CANDIDATES:
            for name, (_, figures) in measure(encoder, templates, settings.negatives, choosing=True).items():
                print(json.dumps({"templates": templates, "score": name, **figures}, ensure_ascii=False))
        return
    results = measure(encoder, settings.templates, settings.negatives)
    entry = {
        "templates": settings.templates,
        "negatives": settings.negatives,
        "date": datetime.date.today().isoformat(),
        "scores": {name: calibration.model_dump() for name, (calibration, _) in results.items()},
        "figures": {name: figures for name, (_, figures) in results.items()},
    }
    print(_written(entry["figures"]))
    if not arguments.dry_run:
        _write(FILE, calibration_key(encoder.name, encoder.sha256), entry)


def _write(path: Path, key: str, entry: dict[str, Any]) -> None:
    known = json.loads(path.read_text()) if path.exists() else {}
    path.write_text(_written(known | {key: entry}) + "\n")


if __name__ == "__main__":
    main()
