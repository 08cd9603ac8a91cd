"""What a run of given seconds measures by: color, labels and depth on the test views of the table-top benchmark.

    python -m benchmarks.training.geometry [DATA] [--seconds 240 480] [--gaussians 40000] [--set NAME=JSON ...]

DATA is by default the tabletop of FASTSPLAT_TEST_DATA: its label maps are given, its test views have a true depth. The
scene is trained on the training split as a job trains it (preset balanced, other seconds and Gaussians) and measured by
`service.evaluation`. A run of twice the seconds shows whether depth drifts. Writes benchmarks/results/geometry.json
after every run; runs of other seconds or settings that are in it stay.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.provenance import RESULTS, begin, provenance, write_json
from fastsplat.service.common.progress import silent
from fastsplat.service.evaluation import evaluate_scene
from fastsplat.service.evaluation.datasets import Dataset, read_dataset
from fastsplat.service.evaluation.train_eval import train_on_split
from fastsplat.service.perception.text import open_text_encoder
from fastsplat.service.planning.presets import apply_preset, override_training
from fastsplat.service.query import SceneIndex
from fastsplat.service.settings import Settings, load_settings
from fastsplat.service.splatting.settings import TrainingSettings

_FIGURES = ("psnr", "ssim", "miou", "boundary_iou", "mask3d_iou", "ghost_rate", "depth_error", "depth_coverage")
_OUT = RESULTS / "geometry.json"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--seconds", type=float, nargs="*", default=[240.0, 480.0])
    parser.add_argument("--gaussians", type=int, default=40_000)
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=JSON", help="other training settings")
    parser.add_argument("--out", type=Path, default=_OUT)
    options = parser.parse_args()
    folder = options.data or Path(os.environ["FASTSPLAT_TEST_DATA"]) / "tabletop"
    others = {name: json.loads(value) for name, value in (item.split("=", 1) for item in options.set)}
    settings = apply_preset(load_settings(), "balanced")
    dataset = read_dataset(folder, settings.capture)
    rows = json.loads(options.out.read_text())["rows"] if options.out.is_file() else []
    for seconds in options.seconds:
        choices = {"time_budget_s": seconds, "max_gaussians": options.gaussians, **others}
        row = {"data": folder.resolve().name, "choices": choices, **_measure(dataset, _with(settings, choices))}
        rows = [old for old in rows if (old["data"], old["choices"]) != (row["data"], choices)] + [row]
        write_json(options.out, {"rows": rows})
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
        "depth_median": round(_median_depth_error(index, dataset), 6),
        "steps": trained.scene.quality.get("iterations"),
        "training_s": round(trained.seconds["training"], 1),
        "cpu_s": round(cpu, 1),
        "bytes": report["bytes"],
        **provenance(start),
    }


def _median_depth_error(index: SceneIndex, dataset: Dataset) -> float:
    """Median of |z − z*| / z* over the pixels of a test view that have a true depth, those without a rendered one
    counting as 1; mean over views."""
    medians = []
    for view in dataset.test:
        if view.depth is None or view.posed is None:
            continue
        depth = index.depth(view.posed)
        known = view.depth > 0 if view.valid is None else (view.depth > 0) & view.valid
        error = np.where(depth > 0, np.abs(depth - view.depth), view.depth)[known] / view.depth[known]
        medians.append(float(np.median(error)))
    return float(np.mean(medians))


if __name__ == "__main__":
    main()
