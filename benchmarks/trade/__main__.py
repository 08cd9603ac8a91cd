"""`python -m benchmarks.trade`: measures what is missing in benchmarks/results/trade.json, prints and draws the table.

    python -m benchmarks.trade [--minutes 45] [--again PATTERN ...] [--only PATTERN ...] [--threads 2]

Each row runs in a process of its own, so that its peak memory is its own. Rows that are measured already are kept;
--again measures those whose key ("tabletop/harmonics/degree 0"; shell patterns) matches anew. A row that fails is named
and left out; the next run tries it again.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from benchmarks.trade.draw import draw
from benchmarks.trade.rows import BASE, Row, all_rows
from fastsplat.service.splatting.raster.kernels import kernel_options

_RESULTS = Path(__file__).parents[1] / "results"
_LONGEST_ROW_S = 900
_COLUMNS = ("wall_s", "cpu_s", "peak_mb", "bytes", "gaussians", "psnr", "ssim", "miou", "boundary_iou", "ghost_rate")
_COLUMNS += ("localization", "label_map_ms")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=45.0, help="no row begins later than this")
    parser.add_argument("--again", nargs="*", default=[], metavar="PATTERN")
    parser.add_argument("--only", nargs="*", default=["*"], metavar="PATTERN")
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    out = _RESULTS / "trade.json"
    kept: dict[str, dict[str, Any]] = {}
    if out.exists():
        kept = {row["key"]: row for row in json.loads(out.read_text())["rows"]}
    rows = all_rows()
    begun = time.monotonic()
    for row in rows:
        wanted = any(fnmatch(row.key, pattern) for pattern in options.only)
        again = any(fnmatch(row.key, pattern) for pattern in options.again)
        if not wanted or (row.key in kept and not again):
            continue
        if time.monotonic() - begun > 60 * options.minutes:
            print("out of time; run again for the rest")
            break
        found = _measured(row, options.threads)
        if found is not None:
            kept[row.key] = found
            print(_line(found), flush=True)
            _write(out, [kept[key] for key in (row.key for row in rows) if key in kept], options.threads)
    for row in (kept[key] for key in (row.key for row in rows) if key in kept):
        print(_line(row))
    draw(list(kept.values()), _RESULTS)


def _measured(row: Row, threads: int) -> dict[str, Any] | None:
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "row.json"
        environment = {**os.environ, "FASTSPLAT_RASTER_THREADS": str(threads), "OMP_WAIT_POLICY": "passive"}
        load = os.getloadavg()[0]
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.trade.measure", str(result)],
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
    about = {"key": row.key, "data": row.data, "factor": row.factor, "value": row.value, "date": time.strftime("%F")}
    changed = {name: value for name, value in asdict(row).items() if name in ("training", "perception", "query")}
    return {**about, **{name: value for name, value in changed.items() if value}, "load": round(load, 1), **figures}


def _write(out: Path, rows: list[dict[str, Any]], threads: int) -> None:
    document = {
        "machine": machine(threads),
        "date": time.strftime("%F"),
        "command": "python -m benchmarks.trade",
        "note": "wall_s and cpu_s are the training's (perception has its own); other programs shared the machine, so "
        "cpu_s (of both threads together) is what to compare; load is the machine's when the row began",
        "base": BASE,
        "rows": rows,
    }
    part = out.with_suffix(".part")
    part.write_text(json.dumps(document, indent=1) + "\n")
    part.replace(out)


def machine(threads: int) -> str:
    """What figures were measured on."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if platform.system() == "Linux" else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    model = models[0] if models else platform.machine()
    return f"{model}, {os.cpu_count()} CPUs, {kernel_options().isa}, {threads} threads"


def _line(row: dict[str, Any]) -> str:
    figures = (f"{name} {row[name]:.4g}" for name in _COLUMNS if name in row)
    return f"{row['key']:48s} " + "  ".join(figures)


if __name__ == "__main__":
    main()
