"""`python -m benchmarks.raster`: prints the table and writes benchmarks/results/raster.json."""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import torch

from benchmarks.raster.measure import Row, label_row, raster_row, step_row
from benchmarks.raster.scenes import garden
from fastsplat.service.splatting.raster.kernels import instruction_sets

_RESULTS = Path(__file__).parents[1] / "results" / "raster.json"


def main() -> None:
    """Measures, each row again until a moment with little other load or the end of --patience.

    With --peers, rows of other programs (same keys, `backend` their name) are shown beside ours.
    """
    parser = argparse.ArgumentParser(description="rasterizer benchmark")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--quick", action="store_true", help="only the rows that have targets")
    parser.add_argument("--patience", type=float, default=20.0, help="seconds a row may wait for a quiet machine")
    parser.add_argument("--peers", type=Path, help="JSON list of rows measured elsewhere on this machine")
    parser.add_argument("--out", type=Path, default=_RESULTS)
    arguments = parser.parse_args()
    torch.set_num_threads(1)

    rows: list[dict[str, object]] = []

    def add(measure: Callable[..., Row], *given: Any, **options: Any) -> None:
        row, share = _quietest(lambda: measure(*given, **options), arguments.patience)
        values = {name: value for name, value in asdict(row).items() if value is not None and value != {}}
        rows.append(values | {"other_cpu": round(share, 3)})
        print(_line(rows[-1]), flush=True)

    load = os.getloadavg()[0]
    threads, rounds = arguments.threads, arguments.rounds
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
    if arguments.peers:
        for row in json.loads(arguments.peers.read_text()):
            rows.append(row)
            print(_line(row))
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    report = {
        "machine": _machine(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "threads": threads,
        "load_average_at_start": round(load, 2),
        "rows": rows,
    }
    arguments.out.write_text(json.dumps(report, indent=1) + "\n")


_COLUMNS = "backend isa threads gaussians width height channels forward_ms backward_ms step_ms label_map_ms".split()
_COLUMNS += ["floor_ratio", "other_cpu"]


_QUIET = 0.05  # of the CPUs: so little use by other programs leaves the figures alone


def _quietest(measure: Callable[[], Row], patience: float) -> tuple[Row, float]:
    """The row during which other programs used the smallest share of the CPUs, and that share."""
    best, least, start = None, 2.0, time.monotonic()
    while best is None or (least > _QUIET and time.monotonic() - start < patience):
        busy, own, then = _busy_seconds(), time.process_time(), time.monotonic()
        row = measure()
        others = (_busy_seconds() - busy) - (time.process_time() - own)
        share = max(0.0, others / ((time.monotonic() - then) * (os.cpu_count() or 1)))
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


def _machine() -> str:
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        names = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    return f"{model}, {len(os.sched_getaffinity(0))} CPUs, {platform.system()}"


if __name__ == "__main__":
    main()
