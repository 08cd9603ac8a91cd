"""`python -m benchmarks.raster`: rasterizer and training step; writes benchmarks/results/raster.json.

The scene is "garden" where FASTSPLAT_TEST_DATA holds it, else a made scene of its statistics; table and file say which,
and their rows are not to be compared with each other. With --peers, rows of other programs (same keys, `backend` their
name) are shown beside ours.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from benchmarks.provenance import MADE_FAST_HERE, begin, parser_of, write_results
from benchmarks.raster.garden import garden, garden_file
from benchmarks.raster.product_step import step_row
from benchmarks.raster.raster_rows import Row, label_row, raster_row
from fastsplat.service.splatting.raster.kernels import instruction_sets


def main() -> None:
    """Measure, each row again until a moment with little other load or the end of --patience."""
    parser = parser_of(__doc__)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--quick", action="store_true", help="only the rows that have targets")
    parser.add_argument("--patience", type=float, default=20.0, help="seconds a row may wait for a quiet machine")
    parser.add_argument("--peers", type=Path, help="JSON list of rows measured elsewhere on this machine")
    arguments = parser.parse_args()
    torch.set_num_threads(1)

    rows: list[dict[str, object]] = []

    def add(measure: Callable[..., Row], *parameters: Any, **options: Any) -> None:
        row, share = _quietest(lambda: measure(*parameters, **options), arguments.patience)
        values = {name: value for name, value in asdict(row).items() if value is not None and value != {}}
        rows.append(values | {"other_cpu": round(share, 3)})
        print(_line(rows[-1]), flush=True)

    start = begin()
    threads, rounds = arguments.threads, arguments.rounds
    source = "made, of garden's statistics" if garden_file() is None else "garden"
    print(f"scene: {source}")
    print(_line({name: name for name in _COLUMNS}))
    small, large = garden(20_000, 320, 240, 6), garden(100_000, 640, 480, 6)
    plain, coded, long = (garden(100_000, 640, 480, channels) for channels in (3, 8, 13))
    for isa in instruction_sets():
        add(raster_row, small, isa, threads, rounds=rounds)
        add(raster_row, large, isa, threads, rounds=rounds)
        add(step_row, small, isa, threads, rounds=rounds)
        add(raster_row, plain, isa, threads, backward=False, rounds=rounds)
        add(label_row, coded, isa, threads, rounds=rounds)
        add(label_row, long, isa, threads, rounds=rounds)
    best = instruction_sets()[0]
    add(raster_row, small, best, 1, rounds=rounds)
    add(raster_row, large, best, 1, rounds=rounds)
    if not arguments.quick:
        for count in (10_000, 30_000, 300_000, 1_000_000):
            add(raster_row, garden(count, 640, 480, 6), best, threads, rounds=max(3, rounds // 3))
        for width, height in ((160, 120), (1280, 720), (1920, 1080)):
            add(raster_row, garden(100_000, width, height, 6), best, threads, rounds=max(3, rounds // 3))
    if arguments.peers and garden_file() is None:
        print("rows of other programs are left out: they were measured on garden")
    elif arguments.peers:
        for row in json.loads(arguments.peers.read_text()):
            rows.append(row)
            print(_line(row))
    write_results("raster", start, arguments, MADE_FAST_HERE, {"scene": source, "threads": threads, "rows": rows})


_COLUMNS = "backend isa threads gaussians width height channels forward_ms backward_ms step_ms label_map_ms".split()
_COLUMNS += ["floor_ratio", "other_cpu"]


_QUIET = 0.05  # of the CPUs: so little use by other programs leaves the figures alone


def _quietest(measure: Callable[[], Row], patience: float) -> tuple[Row, float]:
    """The row during which other programs used the smallest share of the CPUs, and that share."""
    best, least, start = None, 2.0, time.monotonic()
    while best is None or (least > _QUIET and time.monotonic() - start < patience):
        busy, process_s, then = _busy_seconds(), time.process_time(), time.monotonic()
        row = measure()
        background_s = (_busy_seconds() - busy) - (time.process_time() - process_s)
        share = max(0.0, background_s / ((time.monotonic() - then) * (os.cpu_count() or 1)))
        if share < least:
            best, least = row, share
    return best, least


def _busy_seconds() -> float:
    """CPU seconds used by everything on this machine; 0 where the system does not say."""
    stat = Path("/proc/stat")
    if not stat.is_file():
        return 0.0
    user, nice, system, _, _, irq, softirq, steal = (int(n) for n in stat.read_text().split()[1:9])
    return (user + nice + system + irq + softirq + steal) / os.sysconf("SC_CLK_TCK")


def _line(row: dict[str, object]) -> str:
    return " ".join(f"{row.get(name, '')!s:>12}" for name in _COLUMNS)


if __name__ == "__main__":
    main()
