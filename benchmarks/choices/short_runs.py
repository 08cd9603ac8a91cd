"""Runs that are short enough for many of them, and bounded by steps, so that a busy machine changes seconds only."""

from __future__ import annotations

import argparse

from benchmarks.splits import HELD_OUT, add_training_bounds
from fastsplat.service.splatting.settings import TrainingSettings


def add_short_run(parser: argparse.ArgumentParser) -> None:
    """The options of `short_run`: 1,500 steps, 12,000 Gaussians, 240 pixels unless it is told otherwise."""
    add_training_bounds(parser, iterations=1_500, gaussians=12_000, max_side=240)


def short_run(options: argparse.Namespace) -> TrainingSettings:
    """The trainer's defaults with these bounds, measured at the end alone."""
    return TrainingSettings(
        time_budget_s=None,
        iterations=options.iterations,
        max_gaussians=options.gaussians,
        max_side=options.max_side,
        held_out_every=HELD_OUT,
        evaluations=0,
    )
