"""What it costs to make a scene of a splat of another tool: seconds of every step, and peak memory.

    python -m benchmarks.splat_import [GAUSSIANS ...]

By default of 100,000 and 1,000,000 Gaussians with harmonics of degree 3, a made room of flat Gaussians with boxes in
it. Steps: `check` (the upload is read in the confined process), `pictures` (viewpoints are looked for and pictures
rendered), `lifting` (sixteen labels of label maps, and codes fitted to them),
`write` (the scene and its PLY). What models need to label the pictures is not part of it: it does not depend on the
Gaussians. Every size runs in a process of its own and replaces its row in benchmarks/results/splat_import.json.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.provenance import (
    MADE_FAST_HERE,
    RESULTS,
    begin,
    parser_of,
    peak_megabytes,
    provenance,
    write_json,
)
from fastsplat.service.capture.types import Capture
from fastsplat.service.capture.untrusted.sandbox import validate_in_sandbox
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.perception.types import Labelling
from fastsplat.service.pipeline import build_views, train_scene
from fastsplat.service.scene.ply import write_ply
from fastsplat.service.scene.scene_files import write_scene
from fastsplat.service.scene.types import Gaussians, Scene
from fastsplat.service.settings import Settings

_OUT = RESULTS / "splat_import.json"
_SIZES = (100_000, 1_000_000)
_LABELS = 16
_BOXES = 24


def _main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("gaussians", nargs="*", type=int, default=[])
    parser.add_argument("--make", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.make:
        write_ply(made_room(arguments.gaussians[0]), arguments.make / "room.ply")
        return
    if arguments.measure:
        print(json.dumps(_measure(arguments.measure)))
        return
    for count in arguments.gaussians or _SIZES:
        start = begin()
        with tempfile.TemporaryDirectory(prefix="fastsplat-") as work:
            (upload := Path(work) / "upload").mkdir()
            # Each in a process of its own: a process begins with the peak memory of the one that started it.
            command = [sys.executable, "-m", "benchmarks.splat_import"]
            subprocess.run([*command, str(count), "--make", str(upload)], check=True)
            done = subprocess.run([*command, "--measure", work], stdout=subprocess.PIPE, check=True, text=True)
        row = {
            "gaussians": count,
            **json.loads(done.stdout.splitlines()[-1]),
            **provenance(start, settings=arguments, chosen_on=MADE_FAST_HERE),
        }
        rows = json.loads(_OUT.read_text())["rows"] if _OUT.exists() else []
        rows = sorted([*(own for own in rows if own["gaussians"] != count), row], key=lambda own: own["gaussians"])
        write_json(_OUT, {"rows": rows})
        print(row)


def _measure(folder: Path) -> dict[str, Any]:
    settings = Settings()
    seconds: dict[str, float] = {}
    begun = time.monotonic()
    validated = validate_in_sandbox(folder / "upload", settings.capture)
    seconds["check"] = time.monotonic() - begun
    check_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e6
    begun = time.monotonic()
    capture = build_views(validated.folder, folder / "capture", settings)
    seconds["pictures"] = time.monotonic() - begun
    begun = time.monotonic()
    trained = train_scene(capture, _block_labels(capture), settings)
    seconds["lifting"] = time.monotonic() - begun
    begun = time.monotonic()
    scene = Scene(
        gaussians=trained.gaussians,
        head=trained.head,
        dictionary=dictionary_of([f"label {index}" for index in range(_LABELS)]),
        label_embeddings=np.zeros((_LABELS, 384), np.float32),
        text_encoder=("none", "0" * 64),
        cameras=tuple(view.posed for view in capture.views),
        scale="ARBITRARY",
        evidence=trained.evidence,
    )
    write_scene(scene, folder / "artefact")
    write_ply(scene.gaussians, folder / "scene.ply")
    seconds["write"] = time.monotonic() - begun
    return {
        "views": len(capture.views),
        "picture_side": settings.splat_import.picture_side,
        "seconds": {name: round(value, 2) for name, value in seconds.items()},
        "total_seconds": round(sum(seconds.values()), 2),
        "check_peak_mb": round(check_mb),
        "peak_mb": round(peak_megabytes()),
    }


def _block_labels(capture: Capture) -> Labelling:
    """Label maps of blocks: what a label is does not matter for what it costs."""
    camera = capture.views[0].posed.camera
    rows, columns = np.mgrid[: camera.height, : camera.width]
    blocks = (4 * rows // camera.height * 4 + 4 * columns // camera.width) % _LABELS + 1
    maps = tuple(blocks.astype(np.uint16) for _ in capture.views)
    return Labelling(dictionary_of([f"label {index}" for index in range(_LABELS)]), maps, exact=True)


def made_room(count: int) -> Gaussians:
    """A floor, two walls and boxes of flat Gaussians that cover their surfaces once."""
    rng = np.random.default_rng(0)
    panels = [((-2.0, -2.0, 0.0), (2.0, 2.0, 0.0)), ((-2.0, 2.0, 0.0), (2.0, 2.0, 2.0))]
    panels.append(((-2.0, -2.0, 0.0), (-2.0, 2.0, 2.0)))
    for x, y, size in zip(*rng.uniform(-1.5, 1.2, (2, _BOXES)), rng.uniform(0.1, 0.4, _BOXES), strict=True):
        panels.append(((x, y, size), (x + size, y + size, size)))
        panels += [((x, own, 0.0), (x + size, own, size)) for own in (y, y + size)]
        panels += [((own, y, 0.0), (own, y + size, size)) for own in (x, x + size)]
    extents = np.array([np.subtract(high, low) for low, high in panels])
    areas = np.array([np.prod(extent[extent > 0]) for extent in extents])
    owner = rng.choice(len(panels), count, p=areas / areas.sum())
    low = np.array([low for low, _ in panels])
    spread = np.sqrt(areas.sum() / count)
    scales = np.where(extents[owner] > 0, spread, spread / 20)
    return Gaussians(
        means=(low[owner] + rng.random((count, 3)) * extents[owner]).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.log(scales).astype(np.float32),
        logit_opacities=rng.normal(2.5, 1.0, count).astype(np.float32),
        sh=(rng.standard_normal((count, 16, 3)) * 0.2).astype(np.float32),
        codes=np.zeros((count, 0), np.float32),
    )


if __name__ == "__main__":
    _main()
