"""Seconds per photo and memory of captures of 50, 100, 200 and 400 photos of a made room.

`python -m benchmarks.poses.many [--counts 50,100,200,400] [--global-images 150]` writes
`benchmarks/results/poses_many.json`, a row a count and setting; rows measured again are replaced.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.poses.cases import measure_service
from benchmarks.poses.room import write_photos
from benchmarks.provenance import RESULTS, begin, provenance, write_json
from fastsplat.service.capture.settings import CaptureSettings

_RESULT = RESULTS / "poses_many.json"


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--counts", default="50,100,200,400")
    parser.add_argument("--global-images", type=int, default=CaptureSettings().global_mapping_images)
    parser.add_argument("--out", type=Path, default=_RESULT)
    options = parser.parse_args()
    start = begin()
    rows: list[dict[str, Any]] = json.loads(options.out.read_text())["rows"] if options.out.exists() else []
    for count in (int(text) for text in options.counts.split(",")):
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            row = pool.submit(_measure, count, options.global_images).result()
        print(json.dumps(row), flush=True)
        rows = [other for other in rows if _key(other) != _key(row)] + [row]
        rows.sort(key=_key)
        write_json(
            options.out,
            {
                **provenance(
                    start,
                    settings=options,
                    chosen_on="rules of pairs and models: on some of these sets, see docs/photos.md",
                ),
                "rows": rows,
            },
        )


def _measure(count: int, global_images: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "images").mkdir()
        truth = write_photos(folder / "images", count)
        row = measure_service(folder, truth, CaptureSettings(global_mapping_images=global_images))
    mapper = "global first" if count > global_images else "incremental"
    return {"photos": count, "mapper": mapper, "cpu_s_per_photo": round(row["cpu_s"] / count, 2), **row}


def _key(row: dict[str, Any]) -> tuple[Any, ...]:
    return row["photos"], row["mapper"]


if __name__ == "__main__":
    main()
