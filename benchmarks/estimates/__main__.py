"""How long photos take to become a scene, said before, against what their job took.

    python -m benchmarks.estimates [--beside LOOPS] FOLDER[:COUNT] ...

FOLDER holds photos without poses; of COUNT they are taken evenly from the folder. Each is estimated as the page and
`fastsplat check` do before anything is sent, then posted to a worker process, whose job says how long it still takes;
LOOPS processes that do nothing but count run beside from the estimate on. A row says both, stage by stage, and the time
left that was said, as a multiple of the true one: while at least ten seconds were left, with the first line of each
twentieth of the job. Every row replaces itself in benchmarks/results/estimates.json.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from PIL import Image

from benchmarks.provenance import NOT_CHOSEN, RESULTS, begin, parser_of, provenance, put_row
from benchmarks.whole_jobs import run_job
from fastsplat.service.planning.job_time import PhotoSet, job_seconds
from fastsplat.service.planning.machine import machine_speed
from fastsplat.service.settings import Settings
from fastsplat_contract.jobs.operations import Operation, SceneOptions

_LEAST_LEFT_S, _GOAL, _LINES = 10.0, 2.0, 20


def main() -> None:
    """Command line."""
    parser = parser_of(__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER[:COUNT]")
    parser.add_argument("--beside", type=int, default=0, metavar="LOOPS")
    options = parser.parse_args()
    for photos in [_photos(str(words), parser) for words in options.folders]:
        folder = photos[0].parent
        name = folder.parent.name if folder.name == "images" else folder.name
        with _busy(options.beside):
            row = _measured(photos, options)
        beside = f", {options.beside} busy loops beside" if options.beside else ""
        put_row(RESULTS / "estimates.json", f"{name} {row['photos']}{beside}", row)
        print(json.dumps(row, ensure_ascii=False), flush=True)


@contextmanager
def _busy(loops: int) -> Iterator[None]:
    """So many processes that each keep a core busy while the block runs."""
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(loops)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def _photos(words: str, parser: argparse.ArgumentParser) -> list[Path]:
    folder, _, wanted = words.partition(":")
    photos = sorted(path for path in Path(folder).glob("*") if path.suffix.lower() in (".jpg", ".jpeg", ".png"))
    if not photos or not (wanted or "1").isdecimal():
        parser.error(f"{words}: FOLDER must have JPEG or PNG photos, and COUNT be a number")
    count = min(int(wanted or 0) or len(photos), len(photos))
    return [photos[index * len(photos) // count] for index in range(count)]


def _measured(photos: list[Path], options: argparse.Namespace) -> dict[str, Any]:
    start = begin()
    readings: list[tuple[float, float]] = []
    with Image.open(photos[len(photos) // 2]) as photo:
        width, height = photo.size
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data_dir=Path(folder) / "data")
        speed = machine_speed(settings.training.backend)
        estimate = job_seconds(PhotoSet(len(photos), width, height), settings, speed)
        posted = time.monotonic()

        def watch(operation: Operation) -> None:
            if operation.seconds_left is not None:
                readings.append((time.monotonic() - posted, operation.seconds_left))

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
        "time_left": _time_left(readings, job.seconds),
        "speed": {name: round(times, 2) for name, times in asdict(speed).items()},
        **{name: job.quality[name] for name in ("registered_images", "iterations", "psnr") if name in job.quality},
        "load": round(job.load, 1),
        "niceness": settings.jobs.niceness,
        **provenance(start, settings=options, chosen_on=NOT_CHOSEN),
    }


def _time_left(readings: list[tuple[float, float]], whole_s: float) -> dict[str, Any]:
    """Seconds that were said to be left, so many after the job was posted, against the truth."""
    readings = [(at, left) for at, left in readings if whole_s - at >= _LEAST_LEFT_S]
    times = [left / (whole_s - at) for at, left in readings]
    firsts = {int(at / whole_s * _LINES): (at, left) for at, left in reversed(readings)}
    return {
        "said": len(readings),
        "within_a_factor_of_two": round(sum(1 / _GOAL <= ratio <= _GOAL for ratio in times) / max(len(times), 1), 3),
        "least": round(min(times, default=0.0), 2),
        "most": round(max(times, default=0.0), 2),
        "lines": [
            {"at_s": round(at), "said_s": round(left), "true_s": round(whole_s - at)}
            for at, left in (firsts[line] for line in sorted(firsts))
        ],
    }


if __name__ == "__main__":
    main()
