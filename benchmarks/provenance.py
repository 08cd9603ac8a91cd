"""What every committed measurement says of itself: command, settings and what they were chosen on, machine, commit,
date, seconds, and the load around it."""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"

MADE_FAST_HERE = "the program was made fast by this very benchmark; other settings are the defaults"
NOT_CHOSEN = "nothing was chosen on it; settings are the defaults"

_AGAIN = "first on its test views, then again on views of its training split"
_CHOSEN_ON = {
    "tabletop": f"learning rates, draft, planner and rules of objects: {_AGAIN}; label codes: on its test views; "
    "depth and exposure: on views of its training split",
    "sample": f"learning rates, draft, planner and rules of discovery: {_AGAIN}",
    "skull": "draft and planner: on views of its training split",
    "plush": "rules of discovery: on its photos, which have no truth",
}


def chosen_on(data: str, split: str) -> str:
    """What the defaults were chosen on, as far as it concerns figures of `data` ("tabletop", "sample", ...); of a
    validation run, that its figures are there to choose by."""
    if split == "validation":
        return "these are validation views: their figures are there to choose by, and promise nothing"
    return _CHOSEN_ON.get(data, NOT_CHOSEN)


@dataclass(frozen=True)
class Start:
    """The moment before the first measurement.

    Attributes:
        load: the machine's load average over the last minute.
        date: UTC, ISO 8601.
        clock: of `time.monotonic`.
    """

    load: float
    date: str
    clock: float


def begin() -> Start:
    """Now; call it before anything is measured."""
    return Start(os.getloadavg()[0], datetime.now(UTC).isoformat(timespec="seconds"), time.monotonic())


def provenance(start: Start, *, settings: Mapping[str, Any] | argparse.Namespace, chosen_on: str) -> dict[str, Any]:
    """command, settings, chosen_on, machine, commit, date, seconds, load_before and load_after of what was measured
    since `start`.

    Args:
        start: see `begin`.
        settings: what was measured with: the script's options, or the settings themselves. Paths are cut to their last
            part.
        chosen_on: what the settings were chosen on, see `benchmarks.splits`.
    """
    named = vars(settings) if isinstance(settings, argparse.Namespace) else settings
    return {
        "command": command(),
        "settings": {name: _plain(value) for name, value in named.items()},
        "chosen_on": chosen_on,
        "machine": machine(),
        "commit": commit(),
        "date": start.date,
        "seconds": round(time.monotonic() - start.clock, 1),
        "load_before": round(start.load, 2),
        "load_after": round(os.getloadavg()[0], 2),
    }


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Replace a file of results, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    part.replace(path)


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return value.name
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def command() -> str:
    """The command as typed, with absolute paths cut to their last part."""
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    program = Path(sys.argv[0]).name if spec is None else f"-m {spec.name.removesuffix('.__main__')}"
    words = [Path(word).name if word.startswith("/") else word for word in sys.argv[1:]]
    return " ".join(["python", program, *words])


def machine() -> str:
    """Processor, number of CPUs, and the rasterizer's instruction set and threads."""
    from fastsplat.service.splatting.raster.kernels import kernel_options

    options = kernel_options()
    return f"{processor()}, {os.cpu_count()} CPUs, {options.isa}, {options.threads} threads"


def peak_megabytes() -> float:
    """Highest resident memory of this process so far, 10^6 bytes; loads nothing, unlike the evaluation's."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def processor() -> str:
    """The processor's name where the system tells it, else its architecture."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def commit() -> str:
    """The commit that is measured, with "+ changes" where tracked files differ from it; "unknown" outside git."""
    head = _git("rev-parse", "--short=12", "HEAD")
    if not head:
        return "unknown"
    return f"{head} + changes" if _git("status", "--porcelain", "--untracked-files=no") else head


def _git(*words: str) -> str:
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout.strip()
