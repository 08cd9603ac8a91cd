"""Objects of a trained scene against the truth of a data set with id masks and depth.

    python -m benchmarks.query.tabletop DATA --scene ARTEFACT [--out FILE]

DATA is laid out like the tabletop: `transforms.json` with `labels`, `mask_path` and `depth_path`. A label's truth is
the surface that the images show, every patch of 3 mm once; rules of objects are chosen without the images of the test
views (the default), `--split test` takes all. ARTEFACT is a scene's folder as the service stores it. Writes
benchmarks/results/objects_NAME.json: by label how many objects there are (every label is one thing), and how far the
largest one's centroid, box centre and box edges are off, in metres.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.provenance import begin, chosen_on, provenance, write_json
from benchmarks.splits import Split, add_split, results_file
from fastsplat.service.query.gaussian_labels import label_gaussians
from fastsplat.service.query.objects import find_objects
from fastsplat.service.scene.boxes import oriented_box
from fastsplat.service.scene.scene_files import read_scene
from fastsplat.service.scene.types import Scene

_PATCH = 0.003


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--scene", type=Path, required=True, help="artefact folder")
    parser.add_argument("--background", nargs="*", default=["table", "floor", "wall"], help="labels that are no things")
    parser.add_argument("--out", type=Path)
    add_split(parser)
    arguments = parser.parse_args()
    start = begin()
    report = measure(read_scene(arguments.scene), arguments.data, set(arguments.background), arguments.split)
    name = arguments.data.resolve().name
    about = provenance(start, settings=arguments, chosen_on=chosen_on(name, arguments.split))
    report = {**about, **report}
    write_json(arguments.out or results_file(f"objects_{name}", arguments.split), report)
    print(json.dumps(report, indent=1))


def measure(scene: Scene, data: Path, background: set[str], split: Split) -> dict[str, Any]:
    """The report; labels of the scene are looked up by name."""
    start, field = time.process_time(), label_gaussians(scene)
    find_objects(scene, field)  # libraries load
    start = time.process_time()
    objects = find_objects(scene, field)
    seconds = time.process_time() - start
    up = scene.up()
    rows: dict[str, Any] = {}
    for label, points in _surfaces(data, split).items():
        if label in background:
            continue
        label_id = scene.dictionary.id_of(label)
        instances = [thing for thing, _ in objects if thing.label_id == label_id]
        rows[label] = {"objects": len(instances)}
        if instances:
            truth = oriented_box(points, np.ones(len(points)), up)
            rows[label] |= {
                "centroid_off": round(float(np.linalg.norm(instances[0].centroid - points.mean(axis=0))), 4),
                "box_centre_off": round(math.dist(instances[0].box.center.position, truth.center.position), 4),
                "box_size_off": round(float(np.abs(np.subtract(instances[0].box.size, truth.size)).max()), 4),
                "size": np.round(truth.size, 3).tolist(),
                "gaussians": instances[0].gaussian_count,
                "best_views": list(instances[0].best_views),
            }
    off = {key: [row[key] for row in rows.values() if key in row] for key in ("centroid_off", "box_centre_off")}
    return {
        "gaussians": len(scene.gaussians),
        "label_mode": scene.label_mode,
        "cpu_seconds": round(seconds, 3),
        "things": len(rows),
        "found_once": sum(row["objects"] == 1 for row in rows.values()),
        **{f"mean_{key}": round(float(np.mean(values)), 4) for key, values in off.items()},
        **{f"largest_{key}": round(float(np.max(values)), 4) for key, values in off.items()},
        "labels": rows,
    }


def _surfaces(data: Path, split: Split) -> dict[str, np.ndarray]:
    """By label float64 [K, 3], the surface in world coordinates that all images show, or without the test views."""
    document = json.loads((data / "transforms.json").read_text())
    unseen = {str(name) for name in document.get("split", {}).get("test", ())} if split == "validation" else set()
    fx, fy, cx, cy = (document[key] for key in ("fl_x", "fl_y", "cx", "cy"))
    parts: dict[int, list[np.ndarray]] = {}
    for frame in document["frames"]:
        if Path(frame["file_path"]).stem in unseen:
            continue
        pose = np.array(frame["transform_matrix"], np.float64)
        pose[:3, 1:3] *= -1  # OpenGL's axes to OpenCV's
        ids = np.asarray(Image.open(data / frame["mask_path"]))
        z = np.asarray(Image.open(data / frame["depth_path"])).astype(np.float64) * 1e-4
        v, u = np.indices(ids.shape) + 0.5
        points = np.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], axis=-1) @ pose[:3, :3].T + pose[:3, 3]
        for label_id in np.unique(ids[ids > 0]).tolist():
            parts.setdefault(label_id, []).append(points[ids == label_id])
    surfaces = {}
    for label, label_id in document["labels"].items():
        points = np.concatenate(parts[label_id])
        first = np.unique((points / _PATCH).astype(np.int64), axis=0, return_index=True)[1]
        surfaces[label] = points[first]
    return surfaces


if __name__ == "__main__":
    main()
