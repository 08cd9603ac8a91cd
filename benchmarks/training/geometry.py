"""What a run of given seconds measures by: color, labels and depth on views of the table-top benchmark.

    python -m benchmarks.training.geometry [DATA] [--split test] [--seconds 240 480] [--set NAME=JSON ...]

DATA is by default the tabletop of FASTSPLAT_TEST_DATA: its label maps are given, its test views have a true depth. The
scene is trained on the training split as a job trains it (preset balanced, other seconds and Gaussians) and measured by
`service.evaluation`, on views of the training split by default, on the test views with `--split test`. A run of twice
the seconds shows whether depth drifts. Writes benchmarks/results/geometry.json after every run; runs of other seconds
or settings that are in it stay.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.provenance import begin, chosen_on, provenance, write_json
from benchmarks.splits import add_split, results_file
from fastsplat.service.common.progress import silent
from fastsplat.service.evaluation.datasets.reading import read_dataset
from fastsplat.service.evaluation.datasets.types import Dataset
from fastsplat.service.evaluation.scene_evaluation import evaluate_scene
from fastsplat.service.evaluation.train_eval import train_on_split
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.planning.presets import apply_preset, override_training
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.settings import Settings, load_settings
from fastsplat.service.splatting.settings import TrainingSettings

_FIGURES = (
    "psnr",
    "ssim",
    "miou",
    "miou_per_class",
    "boundary_iou",
    "mask3d_iou",
    "mask3d_iou_per_class",
    "ghost_rate",
    "depth_error",
    "depth_median",
    "depth_coverage",
)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--seconds", type=float, nargs="*", default=[240.0, 480.0])
    parser.add_argument("--gaussians", type=int, default=40_000)
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=JSON", help="other training settings")
    parser.add_argument("--out", type=Path)
    add_split(parser)
    options = parser.parse_args()
    out = options.out or results_file("geometry", options.split)
    folder = options.data or Path(os.environ["FASTSPLAT_TEST_DATA"]) / "tabletop"
    others = {name: json.loads(value) for name, value in (item.split("=", 1) for item in options.set)}
    settings = apply_preset(load_settings(), "balanced")
    dataset = read_dataset(folder, settings.capture, split=options.split)
    rows = json.loads(out.read_text())["rows"] if out.is_file() else []
    for seconds in options.seconds:
        choices = {"time_budget_s": seconds, "max_gaussians": options.gaussians, **others}
        row = {"data": folder.resolve().name, "choices": choices, **_measure(dataset, _with(settings, choices))}
        rows = [old for old in rows if (old["data"], old["choices"]) != (row["data"], choices)] + [row]
        write_json(out, {"rows": rows})
        print(json.dumps(row, ensure_ascii=False), flush=True)


def _with(settings: Settings, choices: dict[str, Any]) -> Settings:
    checked = TrainingSettings.model_validate(settings.training.model_dump() | choices)
    return override_training(settings, **{name: getattr(checked, name) for name in choices})


def _measure(dataset: Dataset, settings: Settings) -> dict[str, Any]:
    start, cpu_before = begin(), time.process_time()
    with tempfile.TemporaryDirectory() as work:
        trained = train_on_split(dataset, settings, Path(work), silent)
    cpu = time.process_time() - cpu_before
    encoder = open_text_encoder(settings.perception.text_encoder, settings.models)
    index = SceneIndex(trained.scene, encoder, settings.query)
    report = evaluate_scene(index, dataset, samples=0).to_json()
    return {
        **{name: report[name] for name in _FIGURES},
        "steps": trained.scene.quality.get("iterations"),
        "training_s": round(trained.seconds["training"], 1),
        "cpu_s": round(cpu, 1),
        "bytes": report["bytes"],
        **provenance(
            start,
            settings=settings.training.model_dump(mode="json"),
            chosen_on=chosen_on(dataset.folder.resolve().name, dataset.split),
        ),
    }


if __name__ == "__main__":
    main()
