"""Chooses the trainer's defaults again, on validation views: each is varied alone around what is the default now.

    python -m benchmarks.choices [--data tabletop sample] [--iterations 1500] [--gaussians 12000] [--max-side 240]
    python -m benchmarks.choices --split test --set NAME=JSON ...

The defaults below were first chosen on the very test views that figures are quoted for. Here every candidate is trained
in as many steps on training views less the validation views, which are then measured; the defaults themselves with
several seeds, whose spread says what a difference means; `judging` has the rule by which a default stands. With
`--split test` the defaults, and the settings of --set if there are any, are trained with the validation views and
measured on the test views, once: both figures go into the same file.

Runs are bounded by steps, so that a busy machine changes nothing but seconds. Writes benchmarks/results/choices.json; a
row that is there is not trained again unless its settings have changed.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping
from typing import Any

from benchmarks.choices.judging import judge
from benchmarks.choices.short_runs import add_short_run, short_run
from benchmarks.provenance import RESULTS, begin, provenance, write_json
from benchmarks.splits import add_split
from benchmarks.trade.bench_captures import BenchData, load_data
from fastsplat.service.common.progress import silent
from fastsplat.service.evaluation.held_out_views import evaluate_views
from fastsplat.service.evaluation.validation_split import Split
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.train import train

CANDIDATES: Mapping[str, tuple[float, ...]] = {
    "rates.means": (1.5e-3, 6e-3),
    "rates.log_scales": (1.5e-2, 6e-2),
    "rates.logit_opacities": (5e-2, 2e-1),
    "rates.sh_dc": (2.5e-3, 1e-2),
    "rates.final_share": (0.1, 0.5),
    "rates.codes": (5e-3, 2e-2),
    "semantic_weight": (0.01, 0.1),
    "opacity_decay": (0.0, 0.06),
}
"""By setting, the values beside the default."""
SEEDS = (0, 1, 2)
_OUT = RESULTS / "choices.json"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="+", choices=("tabletop", "sample"), default=["tabletop", "sample"])
    add_short_run(parser)
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=JSON", help="with --split test: what was chosen")
    add_split(parser)
    options = parser.parse_args()
    base = short_run(options)
    chosen = {name: json.loads(value) for name, value in (item.split("=", 1) for item in options.set)}
    for name in options.data:
        data = load_data(name, options.split)
        for title, settings in _runs(base, options.split, chosen):
            row = f"{name}/{options.split}/{title}"
            known = json.loads(_OUT.read_text()) if _OUT.is_file() else {"rows": {}}
            if known["rows"].get(row, {}).get("settings") == settings.model_dump(mode="json"):
                continue
            figures = _measure(data, settings)
            rows = {**known["rows"], row: figures}
            write_json(_OUT, {"choices": judge(rows, CANDIDATES), "rows": rows})
            print(row, {key: figures[key] for key in ("psnr", "miou")}, flush=True)


def varied(settings: TrainingSettings, changes: Mapping[str, float]) -> TrainingSettings:
    """The settings with some replaced; "rates.means" is `means` of `rates`.

    Raises:
        ValueError: no setting has that name, or the value is out of its bounds.
    """
    document = settings.model_dump()
    for name, value in changes.items():
        *groups, field = name.split(".")
        part = document
        for group in groups:
            part = part.get(group, {})
        if field not in part:
            raise ValueError(f"no setting is called {name!r}")
        part[field] = value
    return TrainingSettings.model_validate(document)


def _runs(base: TrainingSettings, split: Split, chosen: Mapping[str, float]) -> Iterator[tuple[str, TrainingSettings]]:
    if split == "test":
        yield "default seed=0", base
        if chosen:
            yield "chosen: " + " ".join(f"{name}={value:g}" for name, value in chosen.items()), varied(base, chosen)
        return
    for seed in SEEDS:
        yield f"default seed={seed}", base.model_copy(update={"seed": seed})
    for name, values in CANDIDATES.items():
        for value in values:
            yield f"{name}={value:g}", varied(base, {name: value})


def _measure(data: BenchData, settings: TrainingSettings) -> dict[str, Any]:
    start = begin()
    trained = train(data.capture, data.truth, settings, silent)
    report = evaluate_views(
        trained.gaussians, trained.head, data.capture, data.truth, trained.held_out,
        max_side=settings.max_side, backend=settings.backend,
    )  # fmt: skip
    return {
        "psnr": round(trained.quality["psnr"], 3),
        "miou": round(report.mean_iou, 4),
        **provenance(start, settings=settings.model_dump(mode="json"), chosen_on="these rows are what is chosen by"),
    }


if __name__ == "__main__":
    main()
