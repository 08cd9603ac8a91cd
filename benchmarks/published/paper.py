"""Figures that papers report, by data set and scene, and what was measured here beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from benchmarks.evaluation.datasets.dataset import Dataset


class Reported(NamedTuple):
    """One table of a paper.

    Attributes:
        title: what is reported, and where.
        figure: the same of a row that `benchmarks.default_path.measure` made; "minutes": of all its stages.
        methods: the paper's columns.
        scenes: their values, by the name of the scene's folder in small letters, with _ for -.
        digits: how many behind the point.
    """

    title: str
    figure: str
    methods: tuple[str, ...]
    scenes: Mapping[str, tuple[float, ...]]
    digits: int = 3


_FAST_SPLAT = ("LangSplat", "Feature 3DGS", "FAST-Splat")
_GROUPING = ("LangSplat", "Gaussian Grouping")
PAPER: Mapping[str, tuple[Reported, ...]] = {
    "3d_ovs": (
        Reported("mIoU", "miou_views", _FAST_SPLAT, {
            "bed": (0.925, 0.643, 0.933), "covered_desk": (0.779, 0.678, 0.913),
        }),
        Reported("localization accuracy", "localization", _FAST_SPLAT, {
            "bed": (0.992, 0.961, 0.998), "covered_desk": (0.978, 0.895, 0.995),
        }),
        Reported("minutes of training", "minutes", _FAST_SPLAT, {
            "bed": (79.23, 107.25, 13.96), "covered_desk": (78.36, 112.06, 13.96),
        }, 2),
    ),
    "lerf_ovs": (
        Reported("mIoU", "miou_views", _FAST_SPLAT, {
            "ramen": (0.512, 0.600, 0.566), "teatime": (0.651, 0.613, 0.706), "waldo_kitchen": (0.445, 0.533, 0.533),
        }),
        Reported("localization accuracy", "localization", _FAST_SPLAT, {
            "ramen": (0.732, 0.876, 0.935), "teatime": (0.881, 0.890, 0.972), "waldo_kitchen": (0.955, 0.863, 0.971),
        }),
        Reported("minutes of training", "minutes", _FAST_SPLAT, {
            "ramen": (141.98, 116.49, 15.08), "teatime": (175.26, 114.53, 16.70),
            "waldo_kitchen": (189.55, 123.77, 16.59),
        }, 2),
    ),
    "lerf_mask": (
        Reported("mIoU (Gaussian Grouping, Ye et al. 2024, table 1)", "miou_lerf_mask_lenient", _GROUPING, {
            "figurines": (0.528, 0.697), "ramen": (0.504, 0.770), "teatime": (0.695, 0.717),
        }),
        Reported("boundary mIoU (the same)", "mbiou_lerf_mask_lenient", _GROUPING, {
            "figurines": (0.505, 0.679), "ramen": (0.447, 0.687), "teatime": (0.656, 0.661),
        }),
    ),
    "mip_nerf_360": (
        Reported("PSNR, dB (3D Gaussian Splatting, Kerbl et al. 2023, supplement)", "psnr", ("3DGS",), {
            "bicycle": (25.246,), "flowers": (21.520,), "garden": (27.410,), "stump": (26.550,), "treehill": (22.490,),
            "room": (30.632,), "counter": (28.700,), "kitchen": (30.317,), "bonsai": (31.980,),
        }, 2),
        Reported("SSIM (the same)", "ssim", ("3DGS",), {
            "bicycle": (0.771,), "flowers": (0.605,), "garden": (0.868,), "stump": (0.775,), "treehill": (0.638,),
            "room": (0.914,), "counter": (0.905,), "kitchen": (0.922,), "bonsai": (0.938,),
        }),
    ),
}  # fmt: skip
"""By data set. Where a title names no paper it is FAST-Splat's, tables 1 to 3."""
SCENES = sorted({name for reported in PAPER.values() for name in reported[0].scenes})


def set_of(dataset: Dataset) -> str:
    """The published set that a data set is read as: a COLMAP model without annotations is one of Mip-NeRF 360."""
    return "mip_nerf_360" if dataset.kind == "colmap" else dataset.kind


def tables(measured: Mapping[tuple[str, str], Mapping[str, Any]]) -> str:
    """The papers' tables in Markdown, what was measured beside them; a scene that was not measured is left out, and so
    is the mean over a data set of which a scene is missing.

    Args:
        measured: rows of `benchmarks.default_path.measure`, by data set and scene.
    """
    parts = []
    for data_set, several in PAPER.items():
        for reported in several:
            there = [name for name in reported.scenes if (data_set, name) in measured]
            rows = [
                (name, (*reported.scenes[name], _here(measured[data_set, name], reported.figure))) for name in there
            ]
            if len(there) == len(reported.scenes) and reported.figure != "minutes":
                rows.append(("mean", tuple(map(_mean, zip(*(values for _, values in rows), strict=True)))))
            head = ("scene", *reported.methods, "here")
            lines = [
                head,
                ["---"] * len(head),
                *([name, *(_cell(value, reported.digits) for value in values)] for name, values in rows),
            ]
            if there:
                parts.append(
                    "\n".join((f"{data_set}: {reported.title}\n", *(f"| {' | '.join(row)} |" for row in lines)))
                )
    return "\n\n".join(parts)


def _here(row: Mapping[str, Any], figure: str) -> float | None:
    figures: Mapping[str, float | None] = {**row["figures"], "minutes": sum(row["stage_seconds"].values()) / 60}
    return figures[figure]


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if len(known) == len(values) else None


def _cell(value: float | None, digits: int) -> str:
    return "not measured" if value is None else f"{value:.{digits}f}"
