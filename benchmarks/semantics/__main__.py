"""Compares ways to keep labels in a scene, on a data set with exact label maps.

    python -m benchmarks.semantics DATA [--split test] [--rows NAME ...] [--iterations 5000] [--keep FOLDER]

DATA is a folder that `fastsplat evaluate` reads. Ways are chosen by views of its training split, which are measured by
default; with `--split test` the test views are. Measured views are never trained on. Rows:

    codes3           3 numbers a Gaussian, trained jointly with colour and geometry
    codes            as many numbers as the labels ask for
    evidence         colour and geometry alone, then one look at the label maps
    codes+evidence   that look at the Gaussians of `codes`
    detected         codes on what a detector and a segmenter found, after the views' vote
    maps             those label maps themselves, made of the measured views: what the vote has to beat
    half             codes of one kind of thing (`--mask-label`), every second view with its mask

Training is bounded by iterations, so that a busy machine changes seconds only. A scene that lies in `--keep` under the
row's name and the split's is not trained again. Every row replaces itself in benchmarks/results/semantics.json, those
of validation views in semantics_validation.json beside it.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.provenance import Start, begin, chosen_on, provenance, write_json
from benchmarks.splits import add_split, results_file
from fastsplat.service.capture.types import Capture
from fastsplat.service.common.progress import ProgressEvent, silent
from fastsplat.service.evaluation.datasets.reading import TEST_EVERY, read_dataset
from fastsplat.service.evaluation.datasets.training import training_capture
from fastsplat.service.evaluation.datasets.types import Dataset, TrueView
from fastsplat.service.evaluation.scene_evaluation import evaluate_scene
from fastsplat.service.evaluation.segmentation import MaskCounts, mask_counts
from fastsplat.service.perception.labelling import label_capture
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.perception.types import Labelling, Regions
from fastsplat.service.pipeline import build_scene
from fastsplat.service.planning.presets import override_training
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.scene_files import read_scene, write_scene
from fastsplat.service.scene.types import CodeSemantics, Scene, semantics_of
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.training_views import load_views
from fastsplat.service.splatting.view_evidence import views_evidence

_SURFACES = ("table", "floor", "wall")
_PROMPTS = {  # what the label table of the development machine calls these
    "red scissors": "scissors", "magnifying glass": "hand glass", "ramekin": "bowl", "cereal box": "carton",
    "soda can": "can", "utensil holder": "canister",
}  # fmt: skip
_MODES: dict[str, dict[str, Any]] = {
    "codes3": {"label_mode": "codes", "code_size": 3},
    "codes": {"label_mode": "codes"},
    "evidence": {"label_mode": "evidence"},
    "half": {"label_mode": "codes"},
    "detected": {},
}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--rows", nargs="+", default=["codes3", "codes", "evidence", "codes+evidence"])
    parser.add_argument("--iterations", type=int, default=5_000)
    parser.add_argument("--gaussians", type=int, default=40_000)
    parser.add_argument("--max-side", type=int, default=640)
    parser.add_argument("--mask-label", default="")
    parser.add_argument("--tag", default="", help="stored as DATA@TAG, beside the rows of other bounds")
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "fastsplat-semantics")
    add_split(parser)
    options = parser.parse_args()
    settings = Settings()
    every = 2 if options.mask_label else TEST_EVERY
    dataset = read_dataset(
        options.data, settings.capture, test_every=every, mask_label=options.mask_label, split=options.split
    )
    run = _Rows(dataset, settings, options)
    for name in options.rows:
        start = begin()
        figures = run.maps() if name == "maps" else run.scene(name)
        tag = f"@{options.tag}" if options.tag else ""
        _store(f"{options.data.resolve().name}{tag}/{name}", figures, start, options)


class _Rows:
    def __init__(self, dataset: Dataset, settings: Settings, options: argparse.Namespace) -> None:
        self.dataset, self.keep = dataset, options.keep
        bounds = {"iterations": options.iterations, "max_gaussians": options.gaussians, "max_side": options.max_side}
        settings = override_training(settings, **bounds, held_out_every=0, evaluations=0)
        unbounded = settings.training.model_copy(update={"time_budget_s": None})
        self.settings = settings.model_copy(update={"training": unbounded, "perception": _perception(settings)})
        self.things = [entry.label for entry in dataset.dictionary.entries if entry.label not in _SURFACES]

    def scene(self, name: str) -> dict[str, Any]:
        """Figures of one way to keep labels."""
        scene = self._with_evidence() if name == "codes+evidence" else self._stored(name)
        encoder = open_text_encoder(self.settings.perception.text_encoder, self.settings.models)
        index = SceneIndex(scene, encoder, self.settings.query)
        report = evaluate_scene(index, self.dataset, samples=0).to_json()
        names = ("miou", "boundary_iou", "localization", "pixel_accuracy", "ghost_rate", "psnr", "absent_auroc")
        per_class = {label: value for label, value in report["miou_per_class"].items() if value is not None}
        worst = min(per_class, key=lambda label: per_class[label])
        quality = {key: scene.quality.get(key) for key in ("iterations", "train_seconds", "build_cpu_seconds")}
        return {
            **{key: _rounded(report[key]) for key in names},
            "miou_things": _rounded(np.mean([per_class.get(label, 0.0) for label in self.things])),
            "worst_class": [worst, _rounded(per_class[worst])],
            "miou_per_class": {label: _rounded(value) for label, value in per_class.items()},
            "gaussians": len(scene.gaussians),
            "bounds": {key: scene.training.get(key) for key in ("iterations", "max_gaussians", "max_side")},
            "label_bytes_per_gaussian": _rounded(_label_bytes(scene)),
            "mask_ms": _rounded(self._mask_ms(index)),
            **quality,
            **{key: _rounded(scene.quality.get(key)) for key in ("evidence_seconds", "evidence_cpu_seconds")},
        }

    def maps(self) -> dict[str, Any]:
        """The test views' own label maps, one by one."""
        test = {view.name: view for view in self.dataset.test if view.labels is not None}
        blind = replace(self.dataset, train=tuple(test), test=(TrueView(self.dataset.train[0], None),))
        with tempfile.TemporaryDirectory() as work:
            capture = training_capture(blind, Path(work), self.settings.capture, silent)
            labelling = self._detected(capture)
        labels = len(self.dataset.dictionary)
        total = MaskCounts.zeros(labels)
        for view, label_map in zip(capture.views, labelling.label_maps, strict=True):
            truth = test[view.posed.name].labels
            assert truth is not None
            total += mask_counts(label_map, truth, labels)
        iou = np.nan_to_num(total.iou())
        per_class = {label: float(iou[self.dataset.dictionary.id_of(label) or 0]) for label in self.things}
        return {
            "miou_things": _rounded(np.mean(list(per_class.values()))),
            "miou_per_class": {label: _rounded(value) for label, value in per_class.items()},
        }

    def _stored(self, name: str) -> Scene:
        folder = self.keep / f"{self.dataset.folder.resolve().name}-{self.dataset.split}-{name}"
        if not folder.exists():
            settings = override_training(self.settings, **_MODES[name])
            with tempfile.TemporaryDirectory() as work:
                capture = training_capture(self.dataset, Path(work), settings.capture, silent)
                labelling = self._detected(capture) if name == "detected" else None
                before = time.process_time()
                built = build_scene(capture, settings, labelling=labelling, progress=_show)
            quality = {**built.scene.quality, "build_cpu_seconds": time.process_time() - before}
            scene = replace(built.scene, quality=quality)
            write_scene(scene, folder)
        return read_scene(folder)

    def _with_evidence(self) -> Scene:
        scene = self._stored("codes")
        with tempfile.TemporaryDirectory() as work:
            capture = training_capture(self.dataset, Path(work), self.settings.capture, silent)
            labelling = label_capture(capture, self.settings.perception, self.settings.models, (), silent)
            views = load_views(capture, labelling, tuple(range(len(capture.views))), 1_000_000, (1.0,))
        begun, cpu = time.perf_counter(), time.process_time()
        evidence = views_evidence(scene.gaussians, views, len(scene.dictionary) + 1)
        seconds = {"evidence_seconds": time.perf_counter() - begun, "evidence_cpu_seconds": time.process_time() - cpu}
        quality = {**scene.quality, **seconds}
        return replace(scene, evidence=evidence, label_mode="evidence", quality=quality)

    def _detected(self, capture: Capture) -> Labelling:
        """What the models find of the things, in the data set's numbering."""
        blind, perception = replace(capture, given_labels=None), self.settings.perception
        prompts = {_PROMPTS.get(label, label): label for label in self.things}
        detected = label_capture(blind, perception, self.settings.models, tuple(prompts), silent)
        ids = [self.dataset.dictionary.id_of(prompts[entry.label]) or 0 for entry in detected.dictionary.entries]
        table = np.array([0, *ids], np.uint16)
        regions = tuple(
            Regions(
                view.ids, tuple(tuple((int(table[label]), score) for label, score in votes) for votes in view.votes)
            )
            for view in detected.regions
        )
        maps = tuple(table[label_map] for label_map in detected.label_maps)
        return Labelling(self.dataset.dictionary, maps, regions=regions, expected=True)

    def _mask_ms(self, index: SceneIndex) -> float:
        """Of one mask in a test view, the fastest of all: other work on the machine only adds."""
        answer = index.ask([self.things[0]])[0]
        seconds = []
        for view in self.dataset.test * 3:
            if view.posed is not None:
                begun = time.perf_counter()
                index.mask2d(answer, view.posed)
                seconds.append(time.perf_counter() - begun)
        return 1000 * min(seconds)


def _perception(settings: Settings) -> PerceptionSettings:
    perception = settings.perception
    if perception.open_set_detector:
        return perception
    return perception.model_copy(
        update={
            "open_set_detector": "yolo_world:yolo_world_s",
            "prompt_encoder": "label_table:clip_text_vocab",
            "open_score_threshold": 0.15,
            "open_score_floor": 0.08,
        }
    )


def _label_bytes(scene: Scene) -> float:
    """Bytes that a Gaussian's label takes, the affine map not counted."""
    evidence = semantics_of(scene)
    if isinstance(evidence, CodeSemantics):
        return float(evidence.codes.itemsize * evidence.codes.shape[1])
    return (evidence.starts.nbytes + evidence.labels.nbytes + evidence.counts.nbytes) / max(1, len(scene.gaussians))


def _rounded(value: Any) -> float | None:
    return None if value is None else round(float(value), 5)


def _show(event: ProgressEvent) -> None:
    print(f"\r{event.stage} {event.fraction:.0%} {event.message}", end="", file=sys.stderr, flush=True)


def _store(name: str, figures: dict[str, Any], start: Start, options: argparse.Namespace) -> None:
    out = results_file("semantics", options.split)
    chosen = chosen_on(options.data.resolve().name, options.split)
    row = {**figures, **provenance(start, settings=options, chosen_on=chosen)}
    rows = json.loads(out.read_text()) if out.exists() else {}
    write_json(out, {**rows, name: row})
    print(json.dumps({key: value for key, value in row.items() if key != "miou_per_class"}, indent=1))


if __name__ == "__main__":
    main()
