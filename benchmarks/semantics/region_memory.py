"""`python -m benchmarks.semantics.region_memory [--views 500] [--regions 60] [--gaussians 40000] [--seen 0.4]`

Groups regions of made views and prints seconds and peak memory beside what they take to make. A view sees a part of the
Gaussians, cuts things out under its own numbers, and gives one Gaussian in ten to a wrong thing.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from collections.abc import Iterator

import numpy as np
import torch

from fastsplat.service.splatting.raster.types import LabelSums
from fastsplat.service.splatting.region_groups import group_regions

_SLIPS = 0.1


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=500)
    parser.add_argument("--regions", type=int, default=60)
    parser.add_argument("--gaussians", type=int, default=40_000)
    parser.add_argument("--seen", type=float, default=0.4, help="share of the Gaussians that a view sees")
    options = parser.parse_args()
    made = made_sums(options.views, options.regions, options.gaussians, options.seen)
    before, begun, cpu = _peak_mb(), time.monotonic(), time.process_time()
    groups = group_regions(made, [options.regions] * options.views)
    dense = 4 * options.views * options.regions * (options.gaussians + 2 * options.views * options.regions)
    print(
        json.dumps(
            {
                "groups": len(groups),
                "largest": max(len(group) for group in groups),
                "seconds": round(time.monotonic() - begun, 1),
                "cpu_seconds": round(time.process_time() - cpu, 1),
                "peak_mb_before": round(before, 1),
                "peak_mb": round(_peak_mb(), 1),
                "dense_matrices_mb": round(dense / 1e6),
            }
        )
    )


def made_sums(views: int, regions: int, gaussians: int, seen: float) -> Iterator[LabelSums]:
    """One after the other, as a run makes them."""
    rng = np.random.default_rng(0)
    thing = rng.integers(0, regions + 1, gaussians)  # 0: no thing
    for _ in range(views):
        number = np.concatenate([[0], rng.permutation(regions) + 1])
        slipped = rng.random(gaussians) < _SLIPS
        label = number[np.where(slipped, rng.integers(0, regions + 1, gaussians), thing)]
        visible = rng.random(gaussians) < seen
        starts = np.concatenate([[0], np.cumsum(visible)])
        weights = rng.exponential(2.0, int(starts[-1]))
        yield LabelSums(
            torch.from_numpy(starts), torch.from_numpy(label[visible].astype(np.int32)), torch.from_numpy(weights)
        )


def _peak_mb() -> float:
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


if __name__ == "__main__":
    main()
