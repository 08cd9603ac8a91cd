"""One row in a process of its own: `python -m benchmarks.trade.measure_row OUT.json validation < row.json`."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.evaluation.validation_split import Split
from benchmarks.provenance import peak_megabytes
from benchmarks.trade.bench_captures import SCRATCH, BenchData, load_data, models, training_labels
from benchmarks.trade.trade_rows import Row
from fastsplat.service.common.progress import silent
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.scene_files import read_scene, write_scene
from fastsplat.service.scene.types import Scene
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.rendering import label_map, rasterize, sh_to_rgb
from fastsplat.service.splatting.raster.types import RasterSettings
from fastsplat.service.splatting.train import train
from fastsplat_contract.camera import PosedCamera

if TYPE_CHECKING:
    from benchmarks.trade.score import Pictures

_TIMED = 5
T = TypeVar("T")


def main() -> None:
    """Measure the row on stdin."""
    row = Row(**json.load(sys.stdin))
    split: Split = "test" if sys.argv[2] == "test" else "validation"
    data, shared = load_data(row.data, split), SCRATCH / f"{row.data}-{split}-base"
    figures = _query_row(row, data, shared) if row.query is not None else _training_row(row, data, shared)
    rounded = {name: round(value, 5) if isinstance(value, float) else value for name, value in figures.items()}
    Path(sys.argv[1]).write_text(json.dumps(rounded))


def _training_row(row: Row, data: BenchData, shared: Path) -> dict[str, Any]:
    figures: dict[str, Any] = {}
    settings, labelling = row.settings(models()), data.truth
    if row.perception is not None:
        labelling, spent = _timed(lambda: training_labels(data, settings))
        figures |= {f"perception_{name}": value for name, value in spent.items()}
    trained, spent = _timed(lambda: train(data.capture, labelling, settings.training, silent))
    figures |= spent
    figures["peak_mb"] = peak_megabytes()
    # The libraries of these are not training's, and not in its peak.
    from benchmarks.trade.score import Pictures, localization, maps_iou, score
    from fastsplat.service.pipeline import assemble_scene

    scene = assemble_scene(trained, labelling, data.capture, settings, trained.quality)
    with tempfile.TemporaryDirectory() as folder:
        write_scene(scene, Path(folder) / "scene")
        figures["bytes"] = sum(path.stat().st_size for path in (Path(folder) / "scene").rglob("*") if path.is_file())
        if row.factor == "base":
            shutil.rmtree(shared, ignore_errors=True)
            shutil.copytree(Path(folder) / "scene", shared)
    index = SceneIndex(scene, open_text_encoder(settings.perception.text_encoder, settings.models), settings.query)
    pictures = Pictures(index.render, index.label_map)
    figures |= {
        "gaussians": len(trained.gaussians),
        "iterations": int(trained.quality["iterations"]),
        "labels": len(labelling.dictionary),
        "code_size": scene.gaussians.codes.shape[1],
        "bytes_per_gaussian": figures["bytes"] / max(1, len(trained.gaussians)),
        "label_map_ms": _milliseconds(lambda posed: index.label_map(posed), data),
        **score(pictures, labelling.dictionary, data, row.perception is not None),
        "localization": localization(index, data, row.perception is not None),
    }
    if row.perception is not None:
        figures["maps_miou"] = maps_iou(labelling, data)
    return figures


def _query_row(row: Row, data: BenchData, shared: Path) -> dict[str, Any]:
    from benchmarks.trade.score import score

    assert row.query is not None
    scene = read_scene(shared)
    pictures = _drawn(scene, row.query)
    return {
        "gaussians": len(scene.gaussians),
        "label_map_ms": _milliseconds(pictures.labels, data),
        "colors_ms": _milliseconds(pictures.colors, data),
        **score(pictures, scene.dictionary, data, False),
    }


def _drawn(scene: Scene, query: dict[str, float]) -> Pictures:
    """The scene drawn with other cut-offs, and at a stride: at 1/n of the size, each pixel n × n of the picture."""
    from benchmarks.trade.score import Pictures

    stride = int(query.get("stride", 1))
    settings = replace(RasterSettings(), **{name: value for name, value in query.items() if name != "stride"})
    gaussians = scene.gaussians
    splats = splats_of(gaussians, torch.tensor(gaussians.codes))
    sh, weight, bias = torch.tensor(gaussians.sh), torch.tensor(scene.head.weight), torch.tensor(scene.head.bias)

    def viewed(posed: PosedCamera) -> tuple[torch.Tensor, PosedCamera]:
        camera = posed.camera
        small = camera.scaled_to(camera.width // stride, camera.height // stride)
        viewmat = torch.tensor(posed.camera_from_world(), dtype=torch.float32)
        return viewmat, PosedCamera(small, posed.world_from_camera, posed.name)

    def enlarged(image: NDArray[Any], posed: PosedCamera, how: int) -> NDArray[Any]:
        size = (posed.camera.width, posed.camera.height)
        return image if stride == 1 else np.asarray(cv2.resize(image, size, interpolation=how))

    def labels(posed: PosedCamera) -> NDArray[Any]:
        viewmat, small = viewed(posed)
        drawn = label_map(splats, viewmat, small.camera, weight, bias, alpha_min=0.5, settings=settings)
        return enlarged(drawn.classes.numpy().astype(np.uint16), posed, cv2.INTER_NEAREST)

    def colors(posed: PosedCamera) -> NDArray[Any]:
        viewmat, small = viewed(posed)
        origin = torch.tensor(posed.world_from_camera[:3, 3], dtype=torch.float32)
        rgb = sh_to_rgb(splats.means, sh, origin, gaussians.sh_degree)
        image = rasterize(replace(splats, features=rgb), viewmat, small.camera, settings=settings).image
        return enlarged((image.clamp(0, 1) * 255).round().byte().numpy(), posed, cv2.INTER_LINEAR)

    return Pictures(colors, labels)


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
