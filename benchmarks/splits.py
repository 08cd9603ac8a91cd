"""Which views a benchmark measures: the test views, or validation views, by which settings are chosen."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from benchmarks.evaluation.validation_split import Split, validation_names
from benchmarks.provenance import RESULTS
from fastsplat.service.capture.captures import Capture
from fastsplat.service.perception.results import Labelling
from fastsplat.service.planning.presets import apply_preset, override_training
from fastsplat.service.settings import Settings, load_settings
from fastsplat_contract.errors import InvalidInputError

HELD_OUT = 5
"""`held_out_every` of runs on captures of `with_split`: any number holds out the views that the capture names."""


def add_split(parser: argparse.ArgumentParser) -> None:
    """The option --split. Scripts measure validation views unless they are told otherwise, as `make bench` does."""
    parser.add_argument(
        "--split",
        choices=("validation", "test"),
        default="validation",
        help="views of the training split, to choose settings by (the default); or the test views, once",
    )


def add_training_bounds(parser: argparse.ArgumentParser, *, iterations: int, gaussians: int, max_side: int) -> None:
    """The options --iterations, --gaussians and --max-side, with these defaults: see `bounded_settings`."""
    parser.add_argument("--iterations", type=int, default=iterations)
    parser.add_argument("--gaussians", type=int, default=gaussians)
    parser.add_argument("--max-side", type=int, default=max_side)


def bounded_settings(options: argparse.Namespace) -> Settings:
    """The balanced preset with so many steps, Gaussians and pixels whatever time they take, so that figures do not
    depend on the machine; nothing is held out by number, and objects are not looked for."""
    bounds = {"iterations": options.iterations, "max_gaussians": options.gaussians, "max_side": options.max_side}
    settings = override_training(apply_preset(load_settings(), "balanced"), **bounds, held_out_every=0, evaluations=0)
    training = settings.training.model_copy(update={"time_budget_s": None})
    discovery = settings.discovery.model_copy(update={"objects": "off"})
    return settings.model_copy(update={"training": training, "discovery": discovery})


def results_file(name: str, split: Split) -> Path:
    """`benchmarks/results/NAME.json`, of validation views `NAME_validation.json`, which git ignores."""
    return RESULTS / (f"{name}.json" if split == "test" else f"{name}_validation.json")


def with_split(
    capture: Capture, labelling: Labelling, test: Collection[str], split: Split
) -> tuple[Capture, Labelling]:
    """The capture whose `test_names` are to be held out and measured, with its label maps.

    Args:
        capture: all views.
        labelling: label maps of all views, or none; regions and masks are not taken along.
        test: names of the test views.
        split: `validation` leaves the test views out altogether.

    Raises:
        InvalidInputError: a test view that is no view of the capture, or too few training views to split.
    """
    names = [view.posed.name for view in capture.views]
    if not test or not set(test) <= set(names):
        raise InvalidInputError(f"no test views {sorted(set(test) - set(names))}", field="test")
    if split == "test":
        return replace(capture, test_names=tuple(name for name in names if name in set(test))), labelling
    rows = [row for row, name in enumerate(names) if name not in set(test)]
    views = tuple(capture.views[row] for row in rows)
    measured = validation_names([names[row] for row in rows], [view.posed.world_from_camera for view in views])
    maps = tuple(labelling.label_maps[row] for row in rows) if labelling.label_maps else ()
    return replace(capture, views=views, test_names=measured, given_labels=None), replace(labelling, label_maps=maps)
