"""Measure from which score on a text encoder's answers deserve to be shown, and write it down.

    python benchmarks/calibration/calibrate.py --models DIR [--encoder NAME] [--templates] [--dry-run]

Every other label of `pairs.txt` sets the thresholds, the remaining ones and the whole dictionaries of `scenes.txt`
judge them:
  related: the score that one in a hundred absent pairs reaches, because a dictionary asks that question once per entry;
  exact: the highest score that a pair which is not exact reaches, because an encoder of sentences puts "toast" as near
    to "toaster" as another name of it.
`--templates` compares prompt templates and both scores instead of writing anything.
"""

from __future__ import annotations

import argparse
import datetime
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.perception.text import TextEncoder, open_text_encoder
from service.query.calibration import FILE, calibration_key
from service.query.embeddings import TextCache
from service.query.relevancy import entries, score
from service.query.settings import QuerySettings

HERE = Path(__file__).parent
_ABSENT_RATE = 0.01
_CANDIDATES: tuple[tuple[str, ...], ...] = (
    ("{}",),
    ("a {}",),
    ("a photo of a {}",),
    ("{}", "a photo of a {}"),
    ("{}", "a {}", "a photo of a {}"),
)


@dataclass(frozen=True)
class Pair:
    """A judgement: what somebody who asks for `query` thinks of being shown `label`."""

    label: str
    query: str
    kind: str
    sets: bool


@dataclass(frozen=True)
class Question:
    """Acceptable first answers to a query in a whole dictionary; none if it should be absent."""

    query: str
    answers: tuple[str, ...]


def read_pairs(path: Path = HERE / "pairs.txt") -> list[Pair]:
    """The judgements of `pairs.txt`; labels in even lines set thresholds, those in odd lines judge them."""
    pairs: list[Pair] = []
    lines = [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
    for number, line in enumerate(lines):
        label, *kinds = (part.strip() for part in line.split("|"))
        for part in kinds:
            kind, queries = part.split(":", 1)
            pairs += [Pair(label, query.strip(), kind.strip(), number % 2 == 0) for query in queries.split(",")]
    return pairs


def read_scenes(path: Path = HERE / "scenes.txt") -> dict[str, tuple[list[str], list[Question]]]:
    """Name to labels and questions."""
    scenes: dict[str, tuple[list[str], list[Question]]] = {}
    name = ""
    for line in path.read_text().splitlines():
        if line.startswith("["):
            name, labels = line[1:].split("]")
            scenes[name] = ([label.strip() for label in labels.split(",")], [])
        elif line and not line.startswith("#"):
            query, answers = (part.strip() for part in line.split("->"))
            wanted = () if answers == "nothing" else tuple(answer.strip() for answer in answers.split(","))
            scenes[name][1].append(Question(query, wanted))
    return scenes


def measure(encoder: TextEncoder, templates: Sequence[str], negatives: Sequence[str]) -> dict[str, dict[str, Any]]:
    """By score (`similarity`, `relevancy`): thresholds and the figures they reach."""
    cache = TextCache(encoder, templates, 100_000)
    pairs, scenes = read_pairs(), read_scenes()
    against = cache.embed(negatives)
    by_pair: dict[str, list[float]] = {"similarity": [], "relevancy": []}
    for pair in pairs:
        found = score(entries(cache.embed([pair.label]), against), cache.embed([pair.query]), 1.0)
        by_pair["similarity"].append(float(found.similarity[0, 0]))
        by_pair["relevancy"].append(float(found.margin[0, 0]))
    return {name: _figures(name, pairs, np.array(values), scenes, cache, against) for name, values in by_pair.items()}


def _figures(
    name: str,
    pairs: Sequence[Pair],
    values: NDArray[np.float64],
    scenes: Mapping[str, tuple[list[str], list[Question]]],
    cache: TextCache,
    negatives: NDArray[np.float32],
) -> dict[str, Any]:
    kinds = np.array([pair.kind for pair in pairs])
    sets = np.array([pair.sets for pair in pairs])
    related_from = float(np.quantile(values[sets & (kinds == "absent")], 1 - _ABSENT_RATE))
    exact_from = float(np.nextafter(values[sets & (kinds != "exact")].max(), np.inf))
    exact, related, absent = (values[~sets & (kinds == kind)] for kind in ("exact", "related", "absent"))
    found = named = present = rightly_absent = asked_absent = 0
    best: list[float] = []
    best_absent: list[float] = []
    wrong: list[str] = []
    for scene, (labels, questions) in scenes.items():
        scores = score(entries(cache.embed(labels), negatives), cache.embed([q.query for q in questions]), 1.0)
        rows = scores.similarity if name == "similarity" else scores.margin
        for question, row in zip(questions, rows, strict=True):
            top, passes = labels[int(row.argmax())], bool(row.max() >= related_from)
            if question.answers:
                present += 1
                found += passes
                named += passes and top in question.answers
                best.append(float(row.max()))
            else:
                asked_absent += 1
                rightly_absent += not passes
                best_absent.append(float(row.max()))
            if passes != bool(question.answers) or (question.answers and top not in question.answers):
                wrong.append(f"{scene}: {question.query} → {top if passes else 'absent'}")
    return {
        "thresholds": {"related": round(related_from, 4), "exact": round(exact_from, 4)},
        "figures": {
            "pairs_held_out": int((~sets).sum()),
            "auroc_related_against_absent": round(auroc(related, absent), 4),
            "auroc_exact_against_rest": round(auroc(exact, np.concatenate([related, absent])), 4),
            "accuracy_related_or_exact_against_absent": round(
                float((np.concatenate([exact, related]) >= related_from).sum() + (absent < related_from).sum())
                / int((~sets).sum()),
                4,
            ),
            "related_recall": round(float((related >= related_from).mean()), 4),
            "absent_false_positives": round(float((absent >= related_from).mean()), 4),
            "exact_recall": round(float((exact >= exact_from).mean()), 4),
            "exact_false_positives": round(float((np.concatenate([related, absent]) >= exact_from).mean()), 4),
            "scenes_found": f"{found}/{present}",
            "scenes_named_rightly": f"{named}/{present}",
            "scenes_rightly_absent": f"{rightly_absent}/{asked_absent}",
            "scenes_auroc_present_against_absent": round(auroc(np.array(best), np.array(best_absent)), 4),
            "scenes_wrong": wrong,
        },
    }


def auroc(positive: NDArray[np.float64], negative: NDArray[np.float64]) -> float:
    """Probability that a positive scores above a negative, ties half."""
    difference = positive[:, None] - negative[None, :]
    return float((difference > 0).mean() + 0.5 * (difference == 0).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", type=Path, required=True, help="model directory")
    parser.add_argument("--encoder", default="minilm_l6_int8", help="text encoder of the model manifest")
    parser.add_argument("--templates", action="store_true", help="compare prompt templates, write nothing")
    parser.add_argument("--dry-run", action="store_true", help="print, write nothing")
    arguments = parser.parse_args()
    encoder = open_text_encoder(arguments.encoder, arguments.models)
    settings = QuerySettings()
    if arguments.templates:
        for templates in _CANDIDATES:
            for name, result in measure(encoder, templates, settings.negatives).items():
                figures = {key: value for key, value in result["figures"].items() if key != "scenes_wrong"}
                print(json.dumps({"templates": templates, "score": name, **figures}, ensure_ascii=False))
        return
    results = measure(encoder, settings.templates, settings.negatives)
    entry = {
        "templates": settings.templates,
        "negatives": settings.negatives,
        "date": datetime.date.today().isoformat(),
        "thresholds": {name: result["thresholds"] for name, result in results.items()},
        "figures": {name: result["figures"] for name, result in results.items()},
    }
    print(json.dumps(entry, indent=1, ensure_ascii=False))
    if not arguments.dry_run:
        known = json.loads(FILE.read_text())
        known[calibration_key(encoder.name, encoder.sha256)] = entry
        FILE.write_text(json.dumps(known, indent=1, ensure_ascii=False, sort_keys=True) + "\n")


if __name__ == "__main__":
    main()
