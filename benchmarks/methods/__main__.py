"""Our labels beside those of other methods: the same photos, label maps, Gaussians, rasterizer, text encoder, protocol.

    python -m benchmarks.methods [NAME ...] [--split test] [--rows ROW ...] [--iterations 4000] [--gaussians 40000]
        [--max-side 640] [--feature-size 16] [--feature-steps 1000] [--feature-side 240]

NAME is `tabletop` (of FASTSPLAT_TEST_DATA) or `sample` (the demo's); both by default. Their label maps of the training
views are given to every method. Rows:

    ours       codes, trained together with color and geometry
    evidence   color and geometry trained alone, then one look at the label maps: ours without codes
    lifted     the text encoder's vector of each pixel's label, averaged onto Gaussians by blend weight (Occam's LGS)
    distilled  a feature field of `--feature-size` numbers a Gaussian, trained on the text encoder's vectors in as many
               principal directions (Feature 3DGS); its rate was chosen on validation views of tabletop
    majority   the label with the largest blend weight (FlashSplat)

All but `ours` are put onto the same Gaussians, trained without labels in as many steps, so that their PSNR is that of
these. `color_s` is that training, `label_s` what the method takes after it (of `ours` all is in `label_s`). Other
methods see images through CLIP, which this machine does not have: here every method is told the labels, so that what
differs is how they are kept in the scene and asked for. Every row replaces itself in benchmarks/results/methods.json,
of validation views (the default) in methods_validation.json.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from benchmarks.methods.fields import FeatureField, Field, HardField, Vocabulary
from benchmarks.methods.lifting import distill_features, lift_features, majority_labels
from benchmarks.methods.scoring import ProductField, score
from benchmarks.provenance import ROOT, begin, chosen_on, provenance, write_json
from benchmarks.splits import add_split, add_training_bounds, bounded_settings, results_file
from fastsplat.service.capture.types import Capture
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import silent
from fastsplat.service.evaluation.datasets.reading import read_dataset
from fastsplat.service.evaluation.datasets.training import training_capture
from fastsplat.service.evaluation.datasets.types import Dataset
from fastsplat.service.evaluation.predictions import truth_ids
from fastsplat.service.perception.labelling import label_capture
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.perception.types import Labelling, TextEncoder
from fastsplat.service.pipeline import build_scene
from fastsplat.service.query.embeddings import embed_names
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.types import Scene, SemanticHead
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.training_views import TrainingView, load_views
from fastsplat.service.splatting.view_evidence import views_evidence

NAMES = ("tabletop", "sample")
ROWS = ("ours", "evidence", "lifted", "distilled", "majority")
_WHOLE = 1_000_000

T = TypeVar("T")


@dataclass(frozen=True)
class _Data:
    """A data set, its training views with label ids of its dictionary, and what is asked of it."""

    dataset: Dataset
    capture: Capture
    labelling: Labelling
    vocabulary: Vocabulary
    encoder: TextEncoder


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[*NAMES, []], default=[])
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=list(ROWS))
    add_training_bounds(parser, iterations=4_000, gaussians=40_000, max_side=640)
    parser.add_argument("--feature-size", type=int, default=16)
    parser.add_argument("--feature-steps", type=int, default=1_000)
    parser.add_argument("--feature-side", type=int, default=240, help="pixels of the pictures that are distilled from")
    parser.add_argument("--out", type=Path)
    add_split(parser)
    options = parser.parse_args()
    settings = bounded_settings(options)
    out = options.out or results_file("methods", options.split)
    for name in options.names or NAMES:
        with tempfile.TemporaryDirectory(prefix="fastsplat-") as work:
            data = _read(name, settings, Path(work), options)
            for row, figures in _rows(data, settings, options):
                rows = json.loads(out.read_text()) if out.is_file() else {}
                write_json(out, {**rows, f"{name}/{row}": figures})
                print(f"{name}/{row}: {json.dumps(figures['figures'])}", flush=True)


def _read(name: str, settings: Settings, work: Path, options: argparse.Namespace) -> _Data:
    folder = ROOT / "demo" / "sample" if name == "sample" else Path(os.environ["FASTSPLAT_TEST_DATA"]) / name
    dataset = read_dataset(folder, settings.capture, split=options.split)
    capture = training_capture(dataset, work, settings.capture, silent)
    labelling = label_capture(capture, settings.perception, settings.models, (), silent)
    table = truth_ids(labelling.dictionary, dataset.dictionary).astype(np.uint16)
    maps = tuple(table[label_map] for label_map in labelling.label_maps)
    encoder = open_text_encoder(settings.perception.text_encoder, settings.models)
    templates = settings.query.templates
    texts = [entry.label for entry in dataset.dictionary.entries]
    vocabulary = Vocabulary(
        embed_names(texts, encoder, templates), embed_names(settings.query.negatives, encoder, templates)
    )
    labelling = replace(labelling, dictionary=dataset.dictionary, label_maps=maps)
    return _Data(dataset, capture, labelling, vocabulary, encoder)


def _rows(data: _Data, settings: Settings, options: argparse.Namespace) -> Iterator[tuple[str, dict[str, Any]]]:
    """Rows in the order asked for; scenes that several need are trained once."""
    plain, color_s = None, {"wall": 0.0, "cpu": 0.0}
    for row in options.rows:
        start = begin()
        if row == "ours":
            scene, label_s = _timed(lambda: _trained(data, settings, data.labelling))
            field: Field = ProductField(SceneIndex(scene, data.encoder, settings.query), data.dataset)
            spent = {"wall": 0.0, "cpu": 0.0}
        else:
            if plain is None:
                plain, color_s = _timed(lambda: _trained(data, settings, Labelling(Dictionary(()), ())))
            scene, spent = plain, color_s
            field, label_s = _timed(lambda row=row, scene=plain: _field(row, scene, data, settings, options))
        index = SceneIndex(scene, data.encoder, settings.query)
        figures = score(field, scene.gaussians, index.render, data.dataset)
        about = provenance(
            start,
            settings={"training": settings.training.model_dump(mode="json"), **vars(options)},
            chosen_on=chosen_on(data.dataset.folder.resolve().name, options.split),
        )
        yield (
            row,
            {
                "figures": {name: None if value is None else round(value, 4) for name, value in figures.items()},
                "color_s": spent,
                "label_s": label_s,
                "gaussians": len(scene.gaussians),
                "split": options.split,
                **about,
            },
        )


def _trained(data: _Data, settings: Settings, labelling: Labelling) -> Scene:
    return build_scene(replace(data.capture, given_labels=None), settings, labelling=labelling).scene


def _field(row: str, scene: Scene, data: _Data, settings: Settings, options: argparse.Namespace) -> Field:
    gaussians, words = scene.gaussians, data.vocabulary
    if row == "evidence":
        classes = len(words.labels) + 1
        evidence = views_evidence(gaussians, _views(data, _WHOLE), classes)
        unused = np.zeros((classes, gaussians.codes.shape[1]), np.float32)
        labelled = replace(
            scene,
            head=SemanticHead(unused, np.zeros(classes, np.float32)),
            dictionary=data.dataset.dictionary,
            label_embeddings=words.labels,
            evidence=evidence,
            label_mode="evidence",
            things=None,
        )
        return ProductField(SceneIndex(labelled, data.encoder, settings.query), data.dataset)
    if row == "lifted":
        return FeatureField(gaussians, lift_features(gaussians, _views(data, _WHOLE), words.labels), None, words)
    if row == "majority":
        return HardField(gaussians, majority_labels(gaussians, _views(data, _WHOLE), len(words.labels)), words)
    views = _views(data, options.feature_side)
    features, decoder = distill_features(
        gaussians, views, words.labels, size=options.feature_size, steps=options.feature_steps
    )
    return FeatureField(gaussians, features, decoder, words)


def _views(data: _Data, side: int) -> tuple[TrainingView, ...]:
    rows = tuple(row for row, label_map in enumerate(data.labelling.label_maps) if label_map.any())
    return load_views(data.capture, data.labelling, rows, side, (1.0,))


def _timed(work: Callable[[], T]) -> tuple[T, dict[str, float]]:
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    return result, {"wall": round(time.perf_counter() - wall, 1), "cpu": round(time.process_time() - cpu, 1)}


if __name__ == "__main__":
    main()
