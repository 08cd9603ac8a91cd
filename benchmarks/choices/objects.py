"""Chooses the rules of objects again: which Gaussians of one label are one thing, and which are specks.

    python -m benchmarks.choices.objects [--data tabletop sample] [--iterations 1500] [--gaussians 12000]
    python -m benchmarks.choices.objects --split test

Scenes are trained on training views with exact label maps, with several seeds, without the test views, and, to choose,
without the validation views. Of tabletop's fourteen labels each is one thing; of the sample's thirteen, four are two
things each (apples, books, donuts, oranges) and the others one. `counted` is the share of labels with as many objects
as there are; `judging` has the rule by which a constant stands. With `--split test` the constants as they are are
measured on scenes of all training views, once. Writes benchmarks/results/choices_objects.json.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any
from unittest.mock import patch

from benchmarks.choices.judging import judge
from benchmarks.choices.short_runs import add_short_run, short_run
from benchmarks.provenance import RESULTS, begin, provenance, write_json
from benchmarks.splits import add_split
from benchmarks.trade.bench_captures import BenchData, load_data, models
from fastsplat.service.common.progress import silent
from fastsplat.service.evaluation.validation_split import Split
from fastsplat.service.pipeline import assemble_scene
from fastsplat.service.query import objects
from fastsplat.service.query.gaussian_labels import label_gaussians
from fastsplat.service.query.objects import find_objects
from fastsplat.service.scene import connectivity
from fastsplat.service.scene.types import Scene
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.train import train

CANDIDATES: Mapping[str, tuple[float, ...]] = {
    "connectivity._NEIGHBORS": (4, 16),
    "connectivity._REACH": (0.7, 1.4),
    "connectivity._WIDEST": (2.0, 8.0),
    "connectivity._SPACINGS": (1.4, 3.0),
    "connectivity._CELL": (0.25, 1.0),
    "objects.MIN_OPACITY": (0.02, 0.1),
    "objects._MIN_SHARE": (0.02, 0.1, 0.2),
    "objects._WIDEST": (2.0, 8.0),
}
"""By constant of `service.scene.connectivity` and `service.query.objects`, the values beside its own."""
SEEDS = (0, 1, 2)
_MODULES = {"connectivity": connectivity, "objects": objects}
_TWO = ("apple", "book", "donut", "orange")
_OUT = RESULTS / "choices_objects.json"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="+", choices=("tabletop", "sample"), default=["tabletop", "sample"])
    add_short_run(parser)
    add_split(parser)
    options = parser.parse_args()
    start = begin()
    base = short_run(options)
    rows: dict[str, dict[str, Any]] = json.loads(_OUT.read_text())["rows"] if _OUT.is_file() else {}
    for name in options.data:
        data = load_data(name, options.split)
        truth = {label: 2 if label in _TWO else 1 for label in data.prompts}
        seeds = [base.model_copy(update={"seed": seed}) for seed in SEEDS]
        scenes = [_trained(data, settings) for settings in seeds]
        for title, constants in _runs(options.split):
            shares = [_counted(scene, truth, constants) for scene in scenes]
            figures = {f"{title} seed={seed}": [share] for seed, share in zip(SEEDS, shares, strict=True)}
            for key, values in (figures if title == "default" else {title: shares}).items():
                counted = round(sum(values) / len(values), 4)
                rows[f"{name}/{options.split}/{key}"] = {"counted": counted}
                print(f"{name}/{options.split}/{key}", counted, flush=True)
        about = provenance(start, settings=base.model_dump(mode="json"), chosen_on="these rows are what is chosen by")
        write_json(_OUT, {**about, "choices": judge(rows, CANDIDATES, _score), "rows": rows})


def _score(figures: Mapping[str, Any]) -> float:
    return float(figures["counted"])


def _runs(split: Split) -> Iterator[tuple[str, tuple[str, float] | None]]:
    yield "default", None
    if split == "validation":
        for name, values in CANDIDATES.items():
            for value in values:
                yield f"{name}={value:g}", (name, value)


def _trained(data: BenchData, settings: TrainingSettings) -> Scene:
    trained = train(data.capture, data.truth, settings, silent)
    return assemble_scene(trained, data.truth, data.capture, Settings(models=models()), trained.quality)


def _counted(scene: Scene, truth: Mapping[str, int], constant: tuple[str, float] | None) -> float:
    """The share of labels with as many objects as there are, 0..1, with one constant replaced."""
    module, name = ("objects", "") if constant is None else constant[0].split(".")
    with patch.dict(vars(_MODULES[module]), {} if constant is None else {name: constant[1]}):
        found = Counter(thing.label for thing, _ in find_objects(scene, label_gaussians(scene)))
    return sum(found[label] == count for label, count in truth.items()) / len(truth)


if __name__ == "__main__":
    main()
