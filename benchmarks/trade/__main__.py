"""`python -m benchmarks.trade`: measures what is missing in its file of results, prints the table and draws it.

    python -m benchmarks.trade [--split test] [--minutes 45] [--again PATTERN ...] [--only PATTERN ...] [--threads 2]

Each row runs in a process of its own, so that its peak memory is its own. Rows that are measured already are kept;
--again measures those whose key ("tabletop/harmonics/degree 0"; shell patterns) matches anew. A row that fails is named
and left out; the next run tries it again. Presets and the planner are chosen by views of the training split, which are
measured by default and go to trade_validation.json; only `--split test` fills trade.json and draws.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from benchmarks.evaluation.validation_split import Split
from benchmarks.provenance import RESULTS, begin, chosen_on, parser_of, provenance, write_json
from benchmarks.splits import add_split, results_file
from benchmarks.trade.draw import draw
from benchmarks.trade.trade_rows import BASE, Row, all_rows

_LONGEST_ROW_S = 1_800
_COLUMNS = [
    *("wall_s", "cpu_s", "peak_mb", "bytes", "gaussians", "psnr_cc", "ssim", "miou", "boundary_iou"),
    *("localization", "label_map_ms"),
]


_NOTE = (
    "wall_s and cpu_s are the training's (perception has its own); where other programs share the machine, cpu_s (of "
    "both threads together) is what to compare; each row has the load and the commit of its own measurement"
)


def main() -> None:
    """Command line."""
    parser = parser_of(__doc__)
    parser.add_argument("--minutes", type=float, default=45.0, help="no row begins later than this")
    parser.add_argument("--again", nargs="*", default=[], metavar="PATTERN")
    parser.add_argument("--only", nargs="*", default=["*"], metavar="PATTERN")
    parser.add_argument("--threads", type=int, default=2)
    add_split(parser)
    options = parser.parse_args()
    out = results_file("trade", options.split)
    start = begin()
    known: dict[str, dict[str, Any]] = {}
    if out.exists():
        known = {row["key"]: row for row in json.loads(out.read_text())["rows"]}
    rows = all_rows()
    begun = time.monotonic()
    for row in rows:
        selected = any(fnmatch(row.key, pattern) for pattern in options.only)
        again = any(fnmatch(row.key, pattern) for pattern in options.again)
        if not selected or (row.key in known and not again):
            continue
        if time.monotonic() - begun > 60 * options.minutes:
            print("out of time; run again for the rest")
            break
        figures = measured(row, options.threads, options.split)
        if figures is not None:
            known[row.key] = figures
            print(_line(figures), flush=True)
            ordered = [known[row.key] for row in rows if row.key in known]
            about = provenance(start, settings=options, chosen_on=chosen_on("tabletop", options.split))
            write_json(out, {**about, "note": _NOTE, "base": BASE, "rows": ordered})
    for row in rows:
        if row.key in known:
            print(_line(known[row.key]))
    if options.split == "test":
        draw(list(known.values()), RESULTS)


def measured(row: Row, threads: int, split: Split) -> dict[str, Any] | None:
    """The figures of a row, from a process of its own; None, and a line on stdout, if that failed."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "row.json"
        environment = {**os.environ, "FASTSPLAT_RASTER_THREADS": str(threads), "OMP_WAIT_POLICY": "passive"}
        start = begin()
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.trade.measure_row", str(result), split],
            input=json.dumps(asdict(row)),
            text=True,
            env=environment,
            timeout=_LONGEST_ROW_S,
            capture_output=True,
        )
        if done.returncode:
            print(f"{row.key}: {done.stderr.strip().splitlines()[-1:]}", flush=True)
            return None
        figures = json.loads(result.read_text())
    about = {"key": row.key, "data": row.data, "factor": row.factor, "value": row.value}
    changed = {name: value for name, value in asdict(row).items() if name in ("training", "perception")}
    about_run = provenance(start, settings={}, chosen_on=chosen_on(row.data, split))
    origin = {name: value for name, value in about_run.items() if name not in ("command", "machine", "settings")}
    return {**about, **{name: value for name, value in changed.items() if value}, **origin, **figures}


def _line(row: dict[str, Any]) -> str:
    figures = (f"{name} {row[name]:.4g}" for name in _COLUMNS if name in row)
    return f"{row['key']:48s} " + "  ".join(figures)


if __name__ == "__main__":
    main()
