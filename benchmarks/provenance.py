"""What every committed measurement says of itself: command, settings and what they were chosen on, machine, commit,
date, sources, seconds, and the load around it."""

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

from benchmarks.sources import sources_of

ROOT = Path(__file__).parents[1]
DRAFT = os.environ.get("DRAFT", "")
"""A folder for results that are not to be committed: of trials, and of a tree that differs from the last commit."""
RESULTS = Path(DRAFT).absolute() if DRAFT else ROOT / "benchmarks" / "results"

_CHANGES, _NOT_RESULTS = " + changes", ":(exclude)benchmarks/results"
_ORIGIN = ("command", "commit", "machine", "date", "load_before")

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
    """The moment before the first measurement: commit, its sources (see `benchmarks.sources`), load average over the
    last minute, UTC, `time.monotonic`."""

    commit: str
    sources: str
    load: float
    date: str
    clock: float


def begin() -> Start:
    """Now; call it before anything is measured.

    Raises:
        UncommittedError: no commit holds what is measured, and the results are no draft.
    """
    measured = commit()
    if not DRAFT and (measured == "unknown" or measured.endswith(_CHANGES)):
        raise UncommittedError(measured)
    sources = sources_of(_module())
    return Start(
        measured, sources, os.getloadavg()[0], datetime.now(UTC).isoformat(timespec="seconds"), time.monotonic()
    )


class UncommittedError(SystemExit):
    """The program ends: what it would measure is in no commit, so that nobody could measure the same again."""

    def __init__(self, measured: str) -> None:
        super().__init__(
            f"Nothing was measured: the commit is {measured}, and nobody could measure the same again. Commit first; "
            "or, for a trial, let its results go into another folder by the variable DRAFT=FOLDER."
        )


def provenance(start: Start, *, settings: Mapping[str, Any] | argparse.Namespace, chosen_on: str) -> dict[str, Any]:
    """command, settings, chosen_on, machine, commit, date, sources, seconds, load_before and load_after of what was
    measured since `start`, with settings or a script's options, whose paths are cut to their last part."""
    named = vars(settings) if isinstance(settings, argparse.Namespace) else settings
    return {
        "command": command(),
        "settings": {name: _plain(value) for name, value in named.items()},
        "chosen_on": chosen_on,
        "machine": machine(),
        "commit": start.commit,
        "date": start.date,
        "sources": start.sources,
        "seconds": round(time.monotonic() - start.clock, 1),
        "load_before": round(start.load, 2),
        "load_after": round(os.getloadavg()[0], 2),
    }


def parser_of(about: str | None) -> argparse.ArgumentParser:
    """A benchmark's options, its docstring as the help."""
    return argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)


def write_results(
    name: str, start: Start, options: argparse.Namespace, chosen_on: str, document: Mapping[str, Any]
) -> None:
    """Replace benchmarks/results/NAME.json by a document with where it comes from, see `provenance`."""
    write_json(RESULTS / f"{name}.json", {**provenance(start, settings=options, chosen_on=chosen_on), **document})


def put_row(path: Path, name: str, row: Mapping[str, Any]) -> None:
    """Put a row into a file of named rows, in the place of the one of that name. See `write_json`."""
    rows = json.loads(path.read_text()) if path.is_file() else {}
    write_json(path, {**rows, name: row})


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Replace a file of results, whole or not at all, by a document that says of itself, or of each of its `rows` or
    values, what `provenance` does. Rows that do not are left out and named on stdout.

    Raises:
        ValueError: nothing in it says where it comes from.
    """
    document = _with_origins(path.name, document)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    part.replace(path)


def _with_origins(name: str, document: Mapping[str, Any]) -> Mapping[str, Any]:
    if all(key in document for key in _ORIGIN):
        return document
    rows = document.get("rows", document)
    if isinstance(rows, Mapping):
        known: Any = {key: row for key, row in rows.items() if _names_its_origin(row)}
        unknown = [key for key in rows if key not in known]
    else:
        known = [row for row in rows if _names_its_origin(row)]
        unknown = [json.dumps(row, ensure_ascii=False)[:80] for row in rows if row not in known]
    if not known:
        raise ValueError(f"{name}: nothing names its {', '.join(_ORIGIN)}")
    for row in unknown:
        print(f"{name}: left out, as it does not say where it comes from: {row}", flush=True)
    return {**document, "rows": known} if "rows" in document else known


def _names_its_origin(row: Any) -> bool:
    origin = row.get("provenance", row) if isinstance(row, Mapping) else {}
    return all(key in origin for key in _ORIGIN)


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
    program = f"-m {_module()}" if _module() else Path(sys.argv[0]).name
    words = [Path(word).name if word.startswith("/") else word for word in sys.argv[1:]]
    return " ".join(["python", program, *words])


def _module() -> str:
    """The name of the module that is the program; "" where it is a file."""
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    return "" if spec is None else spec.name.removesuffix(".__main__")


def machine() -> str:
    """Processor, number of CPUs, and the rasterizer's instruction set and threads."""
    from fastsplat.service.splatting.raster.kernels import kernel_options

    options = kernel_options()
    return f"{processor()}, {os.cpu_count()} CPUs, {options.isa}, {options.threads} threads"


def peak_megabytes() -> float:
    """Highest resident memory of this process so far, 10^6 bytes."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def processor() -> str:
    """The processor's name where the system tells it, else its architecture."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def commit() -> str:
    """The commit that is measured, with "+ changes" where tracked files differ from it, other than results; "unknown"
    outside git."""
    head = _git("rev-parse", "--short=12", "HEAD")
    if not head:
        return "unknown"
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", _NOT_RESULTS)
    return head + _CHANGES if changed else head


def _git(*words: str) -> str:
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return done.stdout.strip()
