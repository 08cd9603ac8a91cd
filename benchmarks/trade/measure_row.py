"""One row in a process of its own: `python -m benchmarks.trade.measure_row OUT.json validation < row.json`."""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import torch

from benchmarks.evaluation.validation_split import Split
from benchmarks.provenance import peak_megabytes
from benchmarks.trade.bench_captures import BenchData, load_data, models, training_labels
from benchmarks.trade.trade_rows import Row
from fastsplat.service.common.progress import silent
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene_facts import SceneFacts
from fastsplat.service.scene.artefact.scene_files import write_scene
from fastsplat.service.splatting.training.train import train
from fastsplat_contract.geometry.camera import PosedCamera

_TIMED = 5
T = TypeVar("T")


def main() -> None:
    """Measure the row on stdin."""
    row = Row(**json.load(sys.stdin))
    split: Split = "test" if sys.argv[2] == "test" else "validation"
    figures = _measure(row, load_data(row.data, split))
    rounded = {name: round(value, 5) if isinstance(value, float) else value for name, value in figures.items()}
    Path(sys.argv[1]).write_text(json.dumps(rounded))


def _measure(row: Row, data: BenchData) -> dict[str, Any]:
    figures, settings, labelling = dict[str, Any](), row.settings(models()), data.truth
    if row.perception is not None:
        labelling, spent = _timed(lambda: training_labels(data, settings))
        figures |= {f"perception_{name}": value for name, value in spent.items()}
    trained, spent = _timed(lambda: train(data.capture, labelling, settings.training, silent))
    figures |= spent
    figures["peak_mb"] = peak_megabytes()
    # The libraries of these are not training's, and not in its peak.
    from benchmarks.trade.score import localization, maps_iou, score
    from fastsplat.service.jobs.create_scene import assemble_scene

    scene = assemble_scene(trained, labelling, data.capture, settings, SceneFacts(), {})
    with tempfile.TemporaryDirectory() as folder:
        write_scene(scene, Path(folder) / "scene")
        figures["bytes"] = sum(path.stat().st_size for path in (Path(folder) / "scene").rglob("*") if path.is_file())
    index = SceneIndex(scene, open_text_encoder(settings.perception.text_encoder, settings.models), settings.query)
    figures |= {
        "gaussians": len(trained.gaussians),
        "iterations": int(trained.quality["iterations"]),
        "psnr_cc": trained.quality["psnr_cc"],
        "labels": len(labelling.dictionary),
        "code_size": scene.gaussians.codes.shape[1],
        "bytes_per_gaussian": figures["bytes"] / max(1, len(trained.gaussians)),
        "label_map_ms": _milliseconds(lambda posed: index.label_map(posed), data),
        **score(index, data, row.perception is not None),
        "localization": localization(index, data, row.perception is not None),
    }
    if row.perception is not None:
        assert figures["miou"], "the scene states none of the detector's names"
        figures["maps_miou"] = maps_iou(labelling, data)
    return figures


def _timed(work: Callable[[], T]) -> tuple[T, dict[str, float]]:
    wall, cpu = time.monotonic(), time.process_time()
    result = work()
    return result, {"wall_s": time.monotonic() - wall, "cpu_s": time.process_time() - cpu}


def _milliseconds(draw: Callable[[PosedCamera], object], data: BenchData) -> float:
    """Best of a few: the machine is shared."""
    posed = data.capture.views[data.test[0]].posed
    taken = []
    for _ in range(_TIMED):
        begun = time.perf_counter()
        draw(posed)
        taken.append(1e3 * (time.perf_counter() - begun))
    return min(taken)


if __name__ == "__main__":
    torch.set_num_threads(2)
    main()
