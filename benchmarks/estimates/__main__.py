"""How long photos take to become a scene, said before, against what their job took.

    python -m benchmarks.estimates FOLDER[:COUNT] ...

FOLDER holds photos without poses; of COUNT they are taken evenly from the folder. Each is estimated as the page and
`fastsplat check` do before anything is sent, then posted to a worker process, whose job says how long it still takes.
A row says both, stage by stage, and how far the time left was off from a fifth of the job on: as a share of the true
time left, while at least ten seconds were left. Every row replaces itself in benchmarks/results/estimates.json.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2

from benchmarks.provenance import NOT_CHOSEN, RESULTS, begin, parser_of, provenance, put_row
from benchmarks.whole_jobs import run_job
from fastsplat.service.planning.job_estimate import PhotoSet, job_seconds
from fastsplat.service.planning.machine import machine_speed
from fastsplat.service.settings import Settings
from fastsplat_contract.operations import Operation, SceneOptions

_LEAST_LEFT_S, _FROM, _GOAL = 10.0, 0.2, 0.25


def main() -> None:
    """Command line."""
    parser = parser_of(__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER[:COUNT]")
    for words in (options := parser.parse_args()).folders:
        folder, _, count = str(words).partition(":")
        name = Path(folder).parent.name if Path(folder).name == "images" else Path(folder).name
        row = _measured(_photos(Path(folder), int(count or 0)), options)
        put_row(RESULTS / "estimates.json", f"{name} {row['photos']}", row)
        print(json.dumps(row, ensure_ascii=False), flush=True)


def _photos(folder: Path, count: int) -> list[Path]:
    photos = sorted(path for path in folder.iterdir() if path.suffix.lower() in (".jpg", ".jpeg", ".png"))
    count = min(count or len(photos), len(photos))
    return [photos[index * len(photos) // count] for index in range(count)]


def _measured(photos: list[Path], options: argparse.Namespace) -> dict[str, Any]:
    start = begin()
    told: list[tuple[float, float]] = []
    height, width = cv2.imread(str(photos[len(photos) // 2])).shape[:2]
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data_dir=Path(folder) / "data")
        speed = machine_speed(settings.training.backend)
        estimate = job_seconds(PhotoSet(len(photos), width, height), settings, speed)
        posted = time.monotonic()

        def watch(operation: Operation) -> None:
            if operation.seconds_left is not None:
                told.append((time.monotonic() - posted, operation.seconds_left))

        job = run_job({path.name: path.read_bytes() for path in photos}, SceneOptions(), settings, watch)
    expected = sum(estimate.values())
    return {
        "photos": len(photos),
        "width": width,
        "height": height,
        "estimated_s": round(expected, 1),
        "actual_s": round(job.seconds, 1),
        "error": round(expected / job.seconds - 1, 3),
        "stages_estimated_s": {stage: round(seconds, 1) for stage, seconds in estimate.items()},
        "stages_actual_s": {stage: round(seconds, 1) for stage, seconds in job.quality["stage_seconds"].items()},
        "time_left": _time_left(told, job.seconds),
        "speed": {name: round(times, 2) for name, times in asdict(speed).items()},
        **{name: job.quality[name] for name in ("registered_images", "iterations", "psnr") if name in job.quality},
        "load": round(job.load, 1),
        **provenance(start, settings=options, chosen_on=NOT_CHOSEN),
    }


def _time_left(told: list[tuple[float, float]], whole_s: float) -> dict[str, Any]:
    """How far what was told of the time left was off, from a fifth of the job on while ten seconds were left.

    Args:
        told: seconds since the job was posted, and seconds that were said to be left.
        whole_s: seconds that the job took.
    """
    errors = [left / (whole_s - at) - 1 for at, left in told if at >= _FROM * whole_s and whole_s - at >= _LEAST_LEFT_S]
    tenths = {}
    for tenth in range(1, 10):
        near = [(abs(at - tenth * whole_s / 10), left) for at, left in told]
        gap, left = min(near, default=(math.inf, 0.0))
        tenths[f"0.{tenth}"] = round(left / (whole_s * (1 - tenth / 10)) - 1, 3) if gap < 0.02 * whole_s else None
    within = sum(abs(error) <= _GOAL for error in errors)
    return {
        "said": len(errors),
        "within_25_percent": round(within / len(errors), 3) if errors else None,
        "error": tenths,
    }


if __name__ == "__main__":
    main()
