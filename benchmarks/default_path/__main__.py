"""What the product makes of photos and poses alone: default models, no names given, everything measured.

    python -m benchmarks.default_path [NAME ...] [--split test] [--preset balanced] [--profile]

NAME is `sample` (the demo's), `tabletop` or `skull` of FASTSPLAT_TEST_DATA; all by default. Each is trained on its
training views as a job trains it that says nothing but "here are photos" (preset balanced), except that no clock
ends the run, so that a busy machine changes seconds only. The detector names what it knows, in its own words: a
true label counts where the scene has that very name or alias, so what is named otherwise, or not at all, counts as
missing. `names_right` says how many true labels the scene has; objects are counted without their names. With --profile
the row says which functions the seconds went to, and goes to profile.json. Every row
replaces itself in benchmarks/results/default_path.json, of validation views (the default) in
default_path_validation.json.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from benchmarks.default_path.own_seconds import OwnSeconds
from benchmarks.evaluation.datasets.dataset import Dataset
from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.evaluation.predictions import truth_ids
from benchmarks.evaluation.scene_evaluation import evaluate_scene, scene_size
from benchmarks.evaluation.train_eval import TrainingLabels, train_on_split
from benchmarks.provenance import ROOT, begin, chosen_on, parser_of, provenance, put_row
from benchmarks.splits import add_split, results_file
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.planning.presets import TOLERANCES_DB, apply_preset
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.settings import Settings, load_settings
from fastsplat_contract.jobs.operations import PresetName

NAMES = ("sample", "tabletop", "skull")
_MASK_LABELS = {"skull": "skull"}
_PERCEPTION = ("closed_set_detector", "open_set_detector", "segmenter", "text_encoder")


def main() -> None:
    """Command line."""
    parser = parser_of(__doc__)
    parser.add_argument("names", nargs="*", choices=[*NAMES, []], default=[])
    parser.add_argument("--preset", choices=TOLERANCES_DB, default="balanced")
    parser.add_argument("--profile", action="store_true")
    add_split(parser)
    options = parser.parse_args()
    settings = apply_preset(load_settings(), options.preset)
    unbounded = settings.training.model_copy(update={"time_budget_s": None, "evaluations": 0})
    settings = settings.model_copy(update={"training": unbounded})
    out = results_file("profile" if options.profile else "default_path", options.split)
    for name in options.names or NAMES:
        folder = ROOT / "demo" / "sample" if name == "sample" else Path(os.environ["FASTSPLAT_TEST_DATA"]) / name
        mask_label = _MASK_LABELS.get(name, "")
        dataset = read_dataset(folder, settings.capture, mask_label=mask_label, split=options.split)
        row = measure(dataset, settings, name, profiled=options.profile, preset=options.preset)
        put_row(out, name, row)
        print(f"{name}: {json.dumps(row, ensure_ascii=False)}", flush=True)


def measure(
    dataset: Dataset,
    settings: Settings,
    name: str,
    *,
    profiled: bool = False,
    labels: TrainingLabels = "default",
    preset: PresetName = "balanced",
) -> dict[str, Any]:
    """Every metric of the data set's measured views, or why there is none, the seconds of each stage, and where all of
    it comes from."""
    start, cpu = begin(), time.process_time()
    watch = OwnSeconds()
    watched = watch if profiled else nullcontext()
    with tempfile.TemporaryDirectory(prefix="fastsplat-") as work, watched:
        trained = train_on_split(dataset, settings, Path(work), labels=labels, preset=preset)
    cpu = time.process_time() - cpu
    index = SceneIndex(
        trained.scene, open_text_encoder(settings.perception.text_encoder, settings.models), settings.query
    )
    report = evaluate_scene(index, dataset)
    named = set(truth_ids(trained.scene.dictionary, dataset.dictionary).tolist()) - {0}
    return {
        "figures": {key: None if value is None else round(value, 4) for key, value in report.figures.items()},
        "not_measured": report.reasons,
        "labels": [entry.label for entry in trained.scene.dictionary.entries],
        "names_right": len(named),
        "names": len(dataset.dictionary),
        "objects": len(index.objects.present),
        "gaussians": len(trained.scene.gaussians),
        "bytes": scene_size(trained.scene),
        "stage_seconds": {stage: round(seconds, 1) for stage, seconds in trained.seconds.items()},
        "cpu_seconds": round(cpu, 1),
        "peak_mb": round(trained.peak_mb, 1),
        **({"own_seconds": watch.rows()} if profiled else {}),
        "split": dataset.split,
        "notes": dataset.notes,
        **provenance(
            start,
            settings={
                "training": settings.training.model_dump(mode="json"),
                "perception": {key: getattr(settings.perception, key) for key in _PERCEPTION},
            },
            chosen_on=chosen_on(name, dataset.split),
        ),
    }


if __name__ == "__main__":
    main()
