"""Times questions to a scene, in process; writes benchmarks/results/query.json.

    python -m benchmarks.query --models DIR [--rounds 31] [--large] [--out FILE]

Texts that are "new" were never embedded before and include the text encoder; all others are cached. Every row is a
median, the fastest round and the median CPU time of all threads: on a busy machine they part.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.query.scenes import labelled_garden
from fastsplat.service.perception.text import open_text_encoder
from fastsplat.service.query import QuerySettings, SceneIndex
from fastsplat.service.query.edits import Edit, apply_edit
from fastsplat.service.query.objects import find_objects
from fastsplat.service.splatting.raster.cpu import instruction_set, thread_count

_RESULTS = Path(__file__).parents[1] / "results" / "query.json"
_ASKED = "something to drink from"
_TARGETS = {"rank_1000_labels": 1.0, "warm_query_new_text": 15.0, "label_map_640x480": 20.0}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", type=Path, required=True, help="model directory")
    parser.add_argument("--rounds", type=int, default=31)
    parser.add_argument("--large", action="store_true", help="a million Gaussians as well")
    parser.add_argument("--out", type=Path, default=_RESULTS)
    arguments = parser.parse_args()
    load = os.getloadavg()[0]
    encoder = open_text_encoder("minilm_l6_int8", arguments.models, threads=2)
    rows: list[dict[str, Any]] = []

    def row(name: str, run: Callable[[], object], rounds: int = arguments.rounds, **about: object) -> None:
        run()
        times, work = [], []
        for _ in range(rounds):
            start, busy = time.perf_counter(), time.process_time()
            run()
            times.append(1e3 * (time.perf_counter() - start))
            work.append(1e3 * (time.process_time() - busy))
        found = {
            "name": name,
            **about,
            "median_ms": round(statistics.median(times), 3),
            "best_ms": round(min(times), 3),
            "cpu_ms": round(statistics.median(work), 3),
        }
        rows.append(found | ({"target_ms": _TARGETS[name]} if name in _TARGETS else {}))
        print(json.dumps(rows[-1]), flush=True)

    new = (f"a thing of kind {number}" for number in count())
    for labels in (20, 1_000):
        index = SceneIndex(labelled_garden(20_000, labels, encoder), encoder)
        for texts, name in (((_ASKED,), f"rank_{labels}_labels"), ((_ASKED,) * 64, f"rank_{labels}_labels_64_texts")):
            row(name, lambda index=index, texts=texts: index.ask(texts), 3 * arguments.rounds)
    for mode in ("codes", "evidence"):
        scene = labelled_garden(100_000, 20, encoder, mode)
        index, posed = SceneIndex(scene, encoder), scene.cameras[0]
        about = {"gaussians": 100_000, "labels": 20, "mode": mode}
        for name, run in _questions(index, new, posed):
            row(name, run, **about)
    _slow_rows(row, labelled_garden(40_000, 20, encoder), 5)
    if arguments.large:
        _slow_rows(row, labelled_garden(1_000_000, 20, encoder), 1)
    report = {
        "command": "python -m benchmarks.query --models DIR" + (" --large" if arguments.large else ""),
        "machine": _machine(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "load_before": round(load, 2),
        "load_after": round(os.getloadavg()[0], 2),
        "coverage": QuerySettings().coverage,
        "rows": rows,
    }
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(report, indent=1) + "\n")


def _questions(index: SceneIndex, new: Iterator[str], posed: Any) -> Iterator[tuple[str, Callable[[], object]]]:
    (answer,) = index.ask(["somewhere to sit"])

    def warm(text: str) -> None:
        (found,) = index.ask([text])
        index.mask3d(found)

    yield "warm_query_known_text", lambda: warm("somewhere to sit")
    yield "warm_query_new_text", lambda: warm(next(new))
    yield "mask3d", lambda: index.mask3d(answer)
    yield "mask2d_640x480", lambda: index.mask2d(answer, posed)
    yield "label_map_640x480", lambda: index.label_map(posed)


def _slow_rows(row: Callable[..., None], scene: Any, rounds: int) -> None:
    from fastsplat.service.query.fields import label_field

    size = len(scene.gaussians)
    index = SceneIndex(scene, _Fixed())
    field, label = label_field(scene), scene.dictionary.entries[0].label
    row("label_field", lambda: label_field(scene), rounds, gaussians=size)
    row("objects", lambda: find_objects(scene, field), rounds, gaussians=size)
    turn = np.eye(4)
    turn[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    for edit in (
        Edit("remove", label=label),
        Edit("recolor", label=label, color=(1.0, 0.0, 0.0)),
        Edit("move", label=label, transform=turn),
        Edit("duplicate", label=label, transform=turn),
    ):
        row(f"edit_{edit.action}", lambda edit=edit: apply_edit(index, edit), rounds, gaussians=size)


class _Fixed:
    """An encoder for what asks nothing."""

    name, sha256 = "fixed", "0" * 64

    def encode(self, texts: Any) -> np.ndarray:
        return np.eye(1, 4, dtype=np.float32).repeat(len(texts), axis=0)


def _machine() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines() if platform.system() == "Linux" else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    model = models[0] if models else platform.machine()
    return f"{model}, {os.cpu_count()} CPUs, {instruction_set()}, {thread_count()} threads"


if __name__ == "__main__":
    main()
