"""Chooses the trainer's defaults again, on validation views: each is varied alone around what is the default now.

    python -m benchmarks.choices [--data tabletop sample] [--iterations 1500] [--gaussians 12000] [--max-side 240]
    python -m benchmarks.choices --split test --set NAME=JSON ...

The defaults below were first chosen on the very test views that figures are quoted for. Here every candidate is trained
in as many steps on training views less the validation views, which are then measured; the defaults themselves with
several seeds, whose spread says what a difference means. `score` is PSNR in dB plus `_MIOU_DB` times the mean IoU. A
candidate replaces a default only if its score is better on every data set by more than twice that spread; `stands` says
of each default that none was. With `--split test` the defaults, and the settings of --set if there are any, are trained
with the validation views and measured on the test views, once: both figures go into the same file.

Runs are bounded by steps, so that a busy machine changes nothing but seconds. Writes benchmarks/results/choices.json; a
row that is there is not trained again unless its settings have changed.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping
from typing import Any

from benchmarks.provenance import RESULTS, begin, provenance, write_json
from benchmarks.splits import HELD_OUT, add_split
from benchmarks.trade.bench_captures import BenchData, load_data
from fastsplat.service.common.progress import silent
from fastsplat.service.evaluation import evaluate_views
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
_MIOU_DB = 20.0  # one dB and .05 of mean IoU count the same
_OUT = RESULTS / "choices.json"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="+", choices=("tabletop", "sample"), default=["tabletop", "sample"])
    parser.add_argument("--iterations", type=int, default=1_500)
    parser.add_argument("--gaussians", type=int, default=12_000)
    parser.add_argument("--max-side", type=int, default=240)
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=JSON", help="with --split test: what was chosen")
    add_split(parser)
    options = parser.parse_args()
    base = TrainingSettings(
        time_budget_s=None,
        iterations=options.iterations,
        max_gaussians=options.gaussians,
        max_side=options.max_side,
        held_out_every=HELD_OUT,
        evaluations=0,
    )
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
            write_json(_OUT, {"choices": judge(rows), "rows": rows})
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


def judge(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """What the validation rows say of each default.

    Args:
        rows: by "DATA/validation/default seed=N" and "DATA/validation/NAME=VALUE", with `psnr` in dB and `miou`.

    Returns:
        By setting: `gains`, of each candidate the score above the mean of the defaults', by data set; `spread`, the
        range of the defaults' scores over their seeds, by data set; `stands`, whether no candidate is better by more
        than twice that on every data set.
    """
    scores: dict[str, dict[str, float]] = {}
    for row, figures in rows.items():
        data, split, title = row.split("/", 2)
        if split == "validation":
            scores.setdefault(data, {})[title] = figures["psnr"] + _MIOU_DB * figures["miou"]
    defaults = {
        data: [score for title, score in titles.items() if title.startswith("default")]
        for data, titles in scores.items()
    }
    spread = {data: max(values) - min(values) for data, values in defaults.items() if values}
    judged = {}
    for name, values in CANDIDATES.items():
        gains = {
            f"{value:g}": {
                data: titles[f"{name}={value:g}"] - sum(defaults[data]) / len(defaults[data])
                for data, titles in scores.items()
                if defaults[data] and f"{name}={value:g}" in titles
            }
            for value in values
        }
        better = [by and all(gain > 2 * spread[data] for data, gain in by.items()) for by in gains.values()]
        judged[name] = {
            "gains": {value: {data: round(gain, 3) for data, gain in by.items()} for value, by in gains.items()},
            "spread": {data: round(value, 3) for data, value in spread.items()},
            "stands": not any(better),
        }
    return judged


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
