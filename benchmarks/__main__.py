"""The list of benchmarks, and their one entry: `python -m benchmarks [NAME [OPTION ...]]`, or `make bench NAME=...`.

Every one guards figures that a document quotes, or fits constants that ship, and writes benchmarks/results/NAME.json by
`benchmarks.provenance`. NAME --help says what it takes and does.
"""

from __future__ import annotations

import os
import runpy
import sys
from collections.abc import Sequence
from typing import NamedTuple

_MODELS = ("--models", os.environ.get("FASTSPLAT_MODELS", ".models"))
_DATA = os.environ.get("FASTSPLAT_TEST_DATA", "FASTSPLAT_TEST_DATA")
_TEST = ("--split", "test")


class Benchmark(NamedTuple):
    """One line of the list.

    Attributes:
        about: what it measures.
        options: what its module is given before the options of the command line.
        module: inside `benchmarks`; "": as it is named.
    """

    about: str
    options: tuple[str, ...] = ()
    module: str = ""


BENCHMARKS = {
    "absence": Benchmark("questions about what is there and what is not, to which nothing was fitted", _MODELS),
    "assistant": Benchmark("200 questions with a known truth, asked through an assistant's tools", _MODELS),
    "budgets": Benchmark("whether jobs end within their time budget", module="trade.budgets"),
    "calibration": Benchmark(
        "fits query/calibration.json, with --lexicon meaning.json", _MODELS, "calibration.calibrate"
    ),
    "changes": Benchmark("what changed in drawn rooms, told by ten photos of another day", _TEST),
    "default_path": Benchmark("photos and poses alone, default models, no names", _TEST),
    "estimates": Benchmark("seconds of a job as estimated before, and as it said while it ran (FOLDER[:COUNT] ...)"),
    "evaluate": Benchmark("a data set of one's own (FOLDER): trained, and every metric measured", module="evaluation"),
    "gpu": Benchmark(
        "parity, training and frames a second on an NVIDIA GPU (pip install '.[cuda]')", module="raster.gpu"
    ),
    "localization": Benchmark("held-out photos localized, photos of other places refused", _TEST),
    "objects": Benchmark("objects without a vocabulary", _TEST),
    "page": Benchmark("the web page: load time, bytes, frames a second, from Enter to glow, without WebGL"),
    "published": Benchmark("scenes of LERF-OVS, LERF-Mask, 3D-OVS or Mip-NeRF 360 (FOLDER), beside papers' figures"),
    "questions": Benchmark("scenes as the product trains them, asked what their photos show (--scenes FOLDER)"),
    "raster": Benchmark("rasterizer and training step", ("--peers", "benchmarks/results/peers.json")),
    "reads": Benchmark("words printed on objects in drawn rooms, read in photos (--split test: other rooms)"),
    "relations": Benchmark("questions about places, sizes and colors in drawn rooms"),
    "rooms": Benchmark(
        "twelve drawn rooms: how whole, clean and rightly named objects are (six; --split test: the others)"
    ),
    "serve": Benchmark("the API under load"),
    "servers": Benchmark("one, two and three API servers of one database and one bucket", module="serve.servers"),
    "subscriptions": Benchmark("subscriptions at 10 poses a second for 10 minutes, a training beside"),
    "trade": Benchmark("what time, memory and bytes buy, as a table and pictures", _TEST),
    "training": Benchmark("PSNR against seconds", (*_TEST, f"{_DATA}/tabletop")),
    "workers": Benchmark("jobs a day by the number of workers, simulated from what a database was asked"),
}


def main(words: Sequence[str]) -> None:
    """Lists the benchmarks, or runs one."""
    if not words or words[0] not in BENCHMARKS:
        print("\n".join(f"{name:14}{benchmark.about}" for name, benchmark in BENCHMARKS.items()))
        sys.exit(f"no benchmark is called {words[0]!r}" if words else 0)
    benchmark = BENCHMARKS[words[0]]
    sys.argv[1:] = [*benchmark.options, *words[1:]]
    runpy.run_module(f"benchmarks.{benchmark.module or words[0]}", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main(sys.argv[1:])
