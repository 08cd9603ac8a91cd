"""Chooses the presets and the planner's trade again, on validation views: each value is varied alone.

    python -m benchmarks.choices.presets [--data tabletop sample skull] [--only PATTERN ...] [--seed 1] [--workers 2]
    python -m benchmarks.choices.presets --split test [--only PATTERN ...]

A preset is a resolution, a number of Gaussians and a degree of harmonics for so many seconds; the planner reduces them
where a time budget is too small for them. Every candidate is trained for as many steps as fit the same seconds on the
reference machine by the planner's model of a step, which makes rows reproducible: a busy machine changes their seconds
only. Scores and the rule by which a default stands are those of `benchmarks.choices`, at the images' own size. With
`--split test` the presets as they are, and `draft` as it was, are measured on the test views, once. Rows go to
benchmarks/results/choices_presets.json; one that is there is not trained again unless its settings have changed. Its
rows `draft_of_degree_0` are those by which `draft` got its harmonics: beside them its default was still degree 0.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from threading import Lock
from typing import Any
from unittest.mock import patch

from benchmarks.choices.judging import judge
from benchmarks.provenance import RESULTS, begin, provenance, write_json
from benchmarks.splits import add_split
from benchmarks.trade.__main__ import measured
from benchmarks.trade.bench_captures import load_data
from benchmarks.trade.trade_rows import Data, Row
from fastsplat.service.evaluation.validation_split import Split
from fastsplat.service.planning import cost_model
from fastsplat.service.planning.cost_model import SceneSize, fit_training, scene_size, steps_per_second
from fastsplat.service.planning.presets import PRESETS
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat_contract.operations import PresetName

PRESET_CANDIDATES: Mapping[PresetName, Mapping[str, tuple[float, ...]]] = {
    "draft": {"max_side": (340, 640), "max_gaussians": (10_000, 40_000), "max_sh_degree": (0, 1)},
    "balanced": {"max_side": (480, 960), "max_gaussians": (20_000, 80_000), "max_sh_degree": (1,)},
}
"""By preset and setting, the values beside the preset's own; of `best`, whose runs take eight minutes, none."""
PLANNER_CANDIDATES: Mapping[str, Mapping[str, tuple[float, ...]]] = {
    "planner_12s": {
        "_SIDE_FACTOR": (0.75, 0.92),
        "_GAUSSIANS_FACTOR": (0.6, 0.85),
        "_ENOUGH_STEPS": (600, 2_400),
        "max_sh_degree": (0, 1),
    },
    "planner_6s": {"max_sh_degree": (0, 1)},
}
"""By time budget, which reduces all three scenes by some levels, and constant of `service.planning.cost_model` or
setting that is asked for, the values beside its own."""
_BUDGETS = {"planner_12s": 12.0, "planner_6s": 6.0}
_DATA: tuple[Data, ...] = ("tabletop", "sample", "skull")
SEEDS = (0, 1)
_STEPS_BESIDE = {"_ENOUGH_STEPS": "_STEPS_A_VIEW"}  # both bound what is enough; the second at 120 of the first
_PRINTED = ("psnr", "miou", "cpu_s")
_OUT = RESULTS / "choices_presets.json"
_KEPT = (
    *("psnr", "ssim", "miou", "boundary_iou", "ghost_rate", "gaussians", "iterations", "bytes", "peak_mb"),
    *("cpu_s", "wall_s", "date", "commit", "load_before", "load_after"),
)


@dataclass(frozen=True)
class Trial:
    """One run, "balanced/default seed=0" or "planner_12s/_SIDE_FACTOR=0.75", on a data set, with the settings that
    differ from those of all rows."""

    data: Data
    title: str
    training: Mapping[str, Any]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="+", choices=_DATA, default=list(_DATA))
    parser.add_argument("--only", nargs="*", default=["*"], metavar="PATTERN", help="of DATA/SPLIT/TITLE")
    parser.add_argument("--seed", type=int, default=0, help="of candidates: for a second look at some of them")
    parser.add_argument("--workers", type=int, default=1, help="rows that are trained at a time, with a thread each")
    add_split(parser)
    options = parser.parse_args()
    start = begin()
    waiting = [
        trial
        for data in options.data
        for trial in (
            _presets(data) if options.split == "test" else trials(data, _size(data, options.split), options.seed)
        )
        if any(fnmatch(_key(trial, options.split), pattern) for pattern in options.only)
    ]
    rows: dict[str, dict[str, Any]] = json.loads(_OUT.read_text())["rows"] if _OUT.is_file() else {}
    waiting = [trial for trial in waiting if rows.get(_key(trial, options.split), {}).get("training") != trial.training]
    threads = 2 if options.workers == 1 else 1
    writing = Lock()

    def run(trial: Trial) -> None:
        figures = measured(Row(trial.data, "choice", trial.title, {**trial.training}), threads, options.split)
        if figures is not None:
            kept = {name: figures[name] for name in _KEPT if name in figures}
            with writing:
                rows[_key(trial, options.split)] = {**kept, "training": trial.training}
                about = provenance(start, settings=options, chosen_on="these rows are what is chosen by")
                write_json(_OUT, {**about, "choices": judged(rows), "rows": rows})
                print(_key(trial, options.split), {name: round(kept[name], 4) for name in _PRINTED}, flush=True)

    with ThreadPoolExecutor(options.workers) as pool:
        list(pool.map(run, waiting))


def trials(data: Data, size: SceneSize, candidates_seed: int = 0) -> Iterator[Trial]:
    """What is trained to choose by; a candidate that changes nothing for images of this size is left out."""
    another = {"seed": candidates_seed} if candidates_seed else {}
    suffix = f" seed={candidates_seed}" if candidates_seed else ""
    for preset, candidates in PRESET_CANDIDATES.items():
        own = _in_time(dict(PRESETS[preset]), size)
        for seed in SEEDS:
            yield Trial(data, f"{preset}/default seed={seed}", {**own, "seed": seed})
        for name, values in candidates.items():
            for value in values:
                changed = _in_time({**PRESETS[preset], name: value}, size)
                if _effective(changed, size) != _effective(own, size):
                    yield Trial(data, f"{preset}/{name}={value:g}{suffix}", {**changed, **another})
    for group, budget in _BUDGETS.items():
        own = _planned({}, size, budget)
        for seed in SEEDS:
            yield Trial(data, f"{group}/default seed={seed}", {**own, "seed": seed})
        for name, values in PLANNER_CANDIDATES[group].items():
            for value in values:
                changed = _planned({name: value}, size, budget)
                if changed != own:
                    yield Trial(data, f"{group}/{name}={value:g}{suffix}", {**changed, **another})


def judged(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """By preset, and by time budget of the planner, what `judge` says of each value that was tried, whatever the
    defaults were then."""
    groups: dict[str, dict[str, Mapping[str, Any]]] = {}
    tried: dict[str, dict[str, set[float]]] = {}
    for row, figures in rows.items():
        data, split, group, title = row.split("/")
        groups.setdefault(group, {})[f"{data}/{split}/{title}"] = figures
        if split == "validation" and not title.startswith("default"):
            name, value = title.split(" ")[0].split("=")
            tried.setdefault(group, {}).setdefault(name, set()).add(float(value))
    return {
        group: judge(own, {name: sorted(values) for name, values in tried.get(group, {}).items()})
        for group, own in groups.items()
    }


def _presets(data: Data) -> Iterator[Trial]:
    size = _size(data, "test")
    for preset in PRESETS:
        yield Trial(data, f"{preset}/default seed=0", {**_in_time(dict(PRESETS[preset]), size), "seed": 0})
    before = _in_time({**PRESETS["draft"], "max_sh_degree": 0}, size)
    yield Trial(data, "draft/max_sh_degree=0", {**before, "seed": 0})


def _in_time(preset: dict[str, Any], size: SceneSize) -> dict[str, Any]:
    """The preset bounded by the steps that fit its seconds on the reference machine."""
    settings = TrainingSettings.model_validate(preset)
    assert settings.time_budget_s is not None
    steps = round(settings.time_budget_s * steps_per_second(settings, size))
    return {**preset, "time_budget_s": None, "iterations": steps, "evaluations": 0}


def _planned(values: Mapping[str, float], size: SceneSize, budget: float) -> dict[str, Any]:
    """What the planner makes of the defaults for so many seconds, with some of them, or of its constants, replaced."""
    constants = {name: value for name, value in values.items() if name.startswith("_")}
    asked = {name: value for name, value in values.items() if not name.startswith("_")}
    beside = {_STEPS_BESIDE[name]: value / 120 for name, value in constants.items() if name in _STEPS_BESIDE}
    with patch.dict(vars(cost_model), {**constants, **beside}):
        plan = fit_training(TrainingSettings.model_validate(asked), size, budget)
    kept = {name: getattr(plan.settings, name) for name in ("max_side", "max_gaussians", "max_sh_degree")}
    return {**kept, "time_budget_s": None, "iterations": plan.steps, "evaluations": 0}


def _effective(training: Mapping[str, Any], size: SceneSize) -> dict[str, Any]:
    return {**training, "max_side": min(training["max_side"], max(size.width, size.height))}


def _size(data: Data, split: Split) -> SceneSize:
    loaded = load_data(data, split)
    return replace(scene_size(loaded.capture, len(loaded.truth.dictionary)), exact_labels=True)


def _key(trial: Trial, split: Split) -> str:
    return f"{trial.data}/{split}/{trial.title}"


if __name__ == "__main__":
    main()
