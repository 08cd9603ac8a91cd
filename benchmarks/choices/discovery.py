"""Chooses the rules of discovery again, on validation views: each setting of `DiscoverySettings` is varied alone.

    python -m benchmarks.choices.discovery [--data tabletop sample] [--iterations 2500] [--gaussians 30000]
    python -m benchmarks.choices.discovery --split test

Scenes are trained on training views without any label, with two seeds; masks are proposed in the same views. What is
found is compared with the truth of views that neither was shown: validation views to choose, with `--split test` the
test views, once, with the settings as they are. The score is the mean of recall and precision at an IoU of .5 and of
the mean IoU of a click; `judging` has the rule by which a default stands. Writes
benchmarks/results/choices_discovery.json.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.choices.judging import judge
from benchmarks.provenance import RESULTS, begin, provenance, write_json
from benchmarks.splits import add_split
from benchmarks.things.__main__ import discovery_data, trained_scene
from fastsplat.service.evaluation.datasets.types import Dataset
from fastsplat.service.evaluation.scene_evaluation import evaluate_scene
from fastsplat.service.evaluation.validation_split import Split
from fastsplat.service.instances.discovery import discover_things
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.perception.capture_masks import propose_capture_masks
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.perception.types import TextEncoder
from fastsplat.service.planning.presets import override_training
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.types import Scene
from fastsplat.service.settings import Settings, load_settings

CANDIDATES: Mapping[str, tuple[float, ...]] = {
    "min_overlap": (0.4, 0.6),
    "min_view_share": (0.05, 0.2),
    "min_consensus": (0.35, 0.55),
    "nested_score": (0.7, 0.84),
    "min_weight_px": (50, 200),
    "surface_share": (0.01, 0.03),
    "piece_consensus": (0.7, 0.9),
    "unexplained_consensus": (0.15, 0.35),
    "weak_share": (0.1, 0.3),
    "stray_share": (0.05, 0.2),
    "refinement_rounds": (1, 3),
}
"""By setting, the values beside the default."""
SEEDS = (0, 1)
_FIGURES = ("things_recall_50", "things_precision", "clicks_miou")
_OUT = RESULTS / "choices_discovery.json"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="+", choices=("tabletop", "sample"), default=["tabletop", "sample"])
    parser.add_argument("--iterations", type=int, default=2_500)
    parser.add_argument("--gaussians", type=int, default=30_000)
    add_split(parser)
    options = parser.parse_args()
    start = begin()
    bounds = {"iterations": options.iterations, "max_gaussians": options.gaussians}
    settings = override_training(load_settings(), **bounds, held_out_every=0)
    settings = settings.model_copy(
        update={"training": settings.training.model_copy(update={"time_budget_s": None, "evaluations": 0})}
    )
    encoder = open_text_encoder(settings.perception.text_encoder, settings.models)
    rows: dict[str, dict[str, Any]] = json.loads(_OUT.read_text())["rows"] if _OUT.is_file() else {}
    for name in options.data:
        with tempfile.TemporaryDirectory(prefix="fastsplat-") as work:
            for row, figures in _measured(name, settings, encoder, Path(work), options.split):
                rows[f"{name}/{options.split}/{row}"] = figures
                print(f"{name}/{options.split}/{row}", figures, flush=True)
        about = provenance(start, settings=settings.training.model_dump(mode="json"), chosen_on=_CHOSEN)
        write_json(_OUT, {**about, "choices": judge(rows, CANDIDATES, score), "rows": rows})


_CHOSEN = "these rows are what is chosen by"


def score(figures: Mapping[str, Any]) -> float:
    """The mean of recall, precision and what a click meets, 0..1."""
    return float(sum(figures[name] for name in _FIGURES) / len(_FIGURES))


def _measured(
    name: str, settings: Settings, encoder: TextEncoder, work: Path, split: Split
) -> Iterator[tuple[str, dict[str, float]]]:
    dataset, capture = discovery_data(name, work, work, settings.capture, split)
    assert dataset is not None  # both have a truth
    masks = propose_capture_masks(capture.views, settings.perception, settings.models)
    scenes = [trained_scene(work / f"seed-{seed}", capture, override_training(settings, seed=seed)) for seed in SEEDS]
    for title, changes in _runs(split):
        rules = DiscoverySettings.model_validate(settings.discovery.model_dump() | changes)
        figures = []
        for scene in scenes:
            things = discover_things(scene.gaussians, capture.views, masks, scene.up(), rules).things
            figures.append(_figures(replace(scene, things=things), dataset, encoder, settings))
        if title == "default":
            yield from ((f"default seed={seed}", own) for seed, own in zip(SEEDS, figures, strict=True))
        else:
            yield title, {key: round(sum(own[key] for own in figures) / len(figures), 4) for key in _FIGURES}


def _runs(split: Split) -> Iterator[tuple[str, dict[str, float]]]:
    yield "default", {}
    if split == "validation":
        for name, values in CANDIDATES.items():
            for value in values:
                yield f"{name}={value:g}", {name: value}


def _figures(scene: Scene, dataset: Dataset, encoder: TextEncoder, settings: Settings) -> dict[str, float]:
    report = evaluate_scene(SceneIndex(scene, encoder, settings.query), dataset, samples=0)
    return {name: round(float(report.value(name) or 0.0), 4) for name in _FIGURES}


if __name__ == "__main__":
    main()
