"""Measure what a text encoder's scores mean, and write it down for the query room.

    python -m benchmarks.calibration.calibrate --models DIR [--encoder NAME] [--templates] [--lexicon NAME] [--dry-run]

The dictionaries of `scenes.txt` are divided in four parts, those that share labels in one (`folds`): the first fits,
the second and third give the conformal scores, the fourth judges.
  related: the best score of a question at which as large a share of what is there is lost as of what is not is let in;
  exact: the highest score that a pair of `pairs.txt` which is not exact reaches, because an encoder of sentences puts
    "toast" as near to "toaster" as another name of it; every other label sets it, the remaining ones judge it.
Probabilities are two logistic models (Platt's scaling); the presence is a half at the threshold.
`--templates` compares prompt templates and both scores instead of writing anything, on the scenes that do not judge, so
that what is chosen by them is judged by scenes that chose nothing. `--lexicon wordnet` fits what weighs lexicon and
encoder instead, see `fit_meaning`; with `--templates` it compares those for this model, by cross-validation.
"""

from __future__ import annotations

import datetime
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from benchmarks.calibration.fit_meaning import compare_templates, fit_meaning
from benchmarks.calibration.folds import folds_of
from benchmarks.calibration.lists import Pair, Questions, read_pairs, read_scenes
from benchmarks.calibration.separation import auroc, balanced, calibration_error, equal_loss, logistic_fit
from benchmarks.provenance import parser_of
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.perception.lexicon.wordnet import open_lexicon
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.language.meaning.calibration import FILE, Score, calibration_key
from fastsplat.service.query.language.meaning.embeddings import TextCache
from fastsplat.service.query.language.meaning.meaning import FILE as MEANING_FILE
from fastsplat.service.query.language.meaning.probability import (
    Logistic,
    Nonconformities,
    ScoreCalibration,
    candidates,
    entry_probability,
    label_set,
    leads,
    present_probability,
)
from fastsplat.service.query.language.meaning.relevancy import entries, relevancy_scores
from fastsplat.service.query.language.ranking import RELATED_PROBABILITY, text_similarity
from fastsplat.service.query.language.words.name_matching import NameIndex, NameMatch
from fastsplat.service.query.query_settings import QuerySettings

F64 = NDArray[np.float64]
_FIT, _CONFORMAL, _JUDGE = 0, (1, 2), 3
"""The parts of the dictionaries."""
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
    """One question with its scores: `part` is its dictionary's, `first` and `also` are rows of the dictionary; `named`
    if the hash table knows the name, so that the scores decide nothing."""

    scene: int
    part: int
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
    scenes = read_scenes()
    if choosing:
        scenes = [scene for scene, part in zip(scenes, _parts(scenes), strict=True) if part != _JUDGE]
    results: dict[Score, tuple[ScoreCalibration, dict[str, Any]]] = {}
    for name in names:
        values = np.array(
            [_scores(name, cache, [pair.label], [pair.query], [NameMatch()], embedded)[0, 0] for pair in pairs]
        )
        exact = _exact_from(pairs, values)
        questions = ask_scenes(name, cache, embedded, scenes)
        margins = questions if name == "relevancy" else ask_scenes("relevancy", cache, embedded, scenes)
        temperature = _temperature(margins)
        calibration = fit(questions, exact, temperature)
        results[name] = (calibration, _pair_figures(pairs, values, calibration) | judge(questions, calibration))
    return results


def ask_scenes(
    name: Score, cache: TextCache, negatives: NDArray[np.float32], scenes: Sequence[Questions] | None = None
) -> list[ScoredQuestion]:
    """Every question of the scenes, by default those of `scenes.txt`, with its scores; `negatives` are embedded."""
    question_sets = read_scenes() if scenes is None else scenes
    return [
        question
        for number, (scene, part) in enumerate(zip(question_sets, _parts(question_sets), strict=True))
        for question in _ask(name, number, part, scene, cache, negatives)
    ]


def _parts(scenes: Sequence[Questions]) -> list[int]:
    return folds_of([scene.labels for scene in scenes], 4)


def fit(questions: Sequence[ScoredQuestion], exact: float, temperature: float) -> ScoreCalibration:
    """The threshold and the logistic models from the first part, the conformal scores from the second and third."""
    fitting = [question for question in questions if question.part == _FIT and not question.named]
    best = np.array([question.scores.max() for question in fitting])
    here = np.array([bool(question.first) for question in fitting])
    related = round(equal_loss(best[here], best[~here]), 4)
    present = logistic_fit(best[:, None], here, balanced(here))
    background = round(float(np.median(best[[not question.first for question in fitting]])), 4)
    features, accepted = [], []
    for question in fitting:
        judged = [row for row in range(len(question.labels)) if row not in question.also]
        features.append(np.stack([question.scores, leads(question.scores, background)], axis=1)[judged])
        accepted += [row in question.first for row in judged]
    entry = logistic_fit(np.concatenate(features), np.array(accepted))
    models = ScoreCalibration(
        related=related,
        exact=round(exact, 4),
        entry=Logistic(score=entry[0], lead=entry[1], offset=entry[2]),
        present=Logistic(score=present[0], offset=round(-present[0] * related, 4)),
        background=background,
        temperature=temperature,
        scenes=Nonconformities(),
    )
    return models.model_copy(update={"scenes": conformal_scenes(questions, models)})


def _temperature(questions: Sequence[ScoredQuestion]) -> float:
    """The t of σ(t·margin) that makes the fitting scenes' judgements likeliest; `questions` hold margins."""
    signed = [
        (margin if row in question.first else -margin)
        for question in questions
        if question.part == _FIT and not question.named
        for row, margin in enumerate(question.scores.tolist())
        if row not in question.also
    ]
    optimum = minimize_scalar(
        lambda t: np.logaddexp(0.0, -t * np.array(signed)).mean(), bounds=(0, 1000), method="bounded"
    )
    return round(float(optimum.x), 2)


def conformal_scenes(questions: Sequence[ScoredQuestion], models: ScoreCalibration) -> Nonconformities:
    """By scene, the nonconformity of each question's best acceptable answer; none where a name decides."""
    present: dict[int, list[float]] = {}
    absent: dict[int, list[float]] = {}
    for question in questions:
        if question.part in _CONFORMAL and not question.named:
            values = nonconformities(question, models)
            by_scene = present if question.first else absent
            by_scene.setdefault(question.scene, []).append(round(min(values[row] for row in acceptable(question)), 5))
    return Nonconformities(present=tuple(map(tuple, present.values())), absent=tuple(map(tuple, absent.values())))


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
    judges = [question for question in scored if question.part == _JUDGE]
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
        bounds = calibration.scenes.bounds(coverage)
        sets = [label_set(nonconformities(question, calibration), bounds) for question in judges]
        covered = np.array([bool(acceptable(q) & set(members)) for q, members in zip(judges, sets, strict=True)])
        figures[f"label_sets_{coverage}"] = {
            "covered_present": round(float(covered[here].mean()), 4),
            "covered_absent": round(float(covered[~np.array(here)].mean()), 4),
            "mean_size": round(float(np.mean([len(chosen) for chosen in sets])), 2),
        }
    share = RELATED_PROBABILITY
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
    pairs = [(row, question) for question in present for row in np.flatnonzero(lists[id(question)]).tolist()]
    welcome = sum(row in question.first or row in question.also for row, question in pairs)
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
            "precision": round(welcome / max(len(pairs), 1), 4),
            "recall": round(hit / acceptable_rows, 4),
            "entries_an_answer": round(len(pairs) / len(present), 2),
        }
    }


def related_rows(scores: F64, entry: F64, calibration: ScoreCalibration, share: float) -> NDArray[np.bool_]:
    """The rule of `service.query.language.ranking`: above the threshold, and likely enough unless it leads."""
    likely: NDArray[np.bool_] = (scores >= calibration.related) & ((entry >= share) | (scores == scores.max()))
    return likely


def _exact_from(pairs: Sequence[Pair], values: F64) -> float:
    setting = [pair.sets and pair.kind != "exact" for pair in pairs]
    return float(np.nextafter(values[setting].max(), np.inf))


def _pair_figures(pairs: Sequence[Pair], values: F64, calibration: ScoreCalibration) -> dict[str, Any]:
    """How well the thresholds judge the pairs that set none."""
    kinds = np.array([pair.kind for pair in pairs])
    judging = np.array([not pair.sets for pair in pairs])
    exact, related, absent = (values[judging & (kinds == kind)] for kind in ("exact", "related", "absent"))
    return {
        "pairs_held_out": int(judging.sum()),
        "auroc_related_against_absent": round(auroc(related, absent), 4),
        "auroc_exact_against_rest": round(auroc(exact, np.concatenate([related, absent])), 4),
        "related_recall": round(float((related >= calibration.related).mean()), 4),
        "absent_false_positives": round(float((absent >= calibration.related).mean()), 4),
        "exact_recall": round(float((exact >= calibration.exact).mean()), 4),
        "exact_false_positives": round(float((np.concatenate([related, absent]) >= calibration.exact).mean()), 4),
    }


def _ask(
    name: Score, number: int, part: int, scene: Questions, cache: TextCache, negatives: NDArray[np.float32]
) -> list[ScoredQuestion]:
    texts = [question.query for question in scene.questions]
    matches = [NameIndex(dictionary_of(scene.labels)).match(text) for text in texts]
    rows = _scores(name, cache, scene.labels, texts, matches, negatives)
    return [
        ScoredQuestion(
            number,
            part,
            scene.name,
            scene.labels,
            question.query,
            row,
            tuple(scene.labels.index(answer) for answer in question.answers),
            tuple(scene.labels.index(answer) for answer in question.also),
            bool(match.exact),
        )
        for question, match, row in zip(scene.questions, matches, rows, strict=True)
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


def _written(entry: dict[str, Any]) -> str:
    """JSON with lists of numbers on one line."""
    text = json.dumps(entry, indent=1, ensure_ascii=False, sort_keys=True)
    return re.sub(r"\[\s+(-?\d[^\[\]]*?)\s+\]", lambda match: "[" + " ".join(match.group(1).split()) + "]", text)


def main() -> None:
    """Command line."""
    parser = parser_of(__doc__)
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
        "figures": (figures := {name: row for name, (_, row) in results.items()}),
    }
    print(_written(figures))
    if not arguments.dry_run:
        _write(FILE, calibration_key(encoder.name, encoder.sha256), entry)


def _write(path: Path, key: str, entry: dict[str, Any]) -> None:
    known = json.loads(path.read_text()) if path.exists() else {}
    path.write_text(_written(known | {key: entry}) + "\n")


if __name__ == "__main__":
    main()
