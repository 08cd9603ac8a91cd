"""Figures of the paper (FAST-Splat: Fast, Ambiguity-Free Semantics Transfer in Gaussian Splatting), by scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple


class Reported(NamedTuple):
    """One scene as the paper's tables have it, each for LangSplat, Feature 3DGS and FAST-Splat.

    Attributes:
        data_set: "3d_ovs" or "lerf_ovs", as `Dataset.kind`.
        miou: of the masks.
        localization: accuracy.
        minutes: of the whole training.
    """

    data_set: str
    miou: tuple[float, float, float]
    localization: tuple[float, float, float]
    minutes: tuple[float, float, float]


PAPER: Mapping[str, Reported] = {
    "bed": Reported("3d_ovs", (0.925, 0.643, 0.933), (0.992, 0.961, 0.998), (79.23, 107.25, 13.96)),
    "covered_desk": Reported("3d_ovs", (0.779, 0.678, 0.913), (0.978, 0.895, 0.995), (78.36, 112.06, 13.96)),
    "ramen": Reported("lerf_ovs", (0.512, 0.600, 0.566), (0.732, 0.876, 0.935), (141.98, 116.49, 15.08)),
    "teatime": Reported("lerf_ovs", (0.651, 0.613, 0.706), (0.881, 0.890, 0.972), (175.26, 114.53, 16.70)),
    "waldo_kitchen": Reported("lerf_ovs", (0.445, 0.533, 0.533), (0.955, 0.863, 0.971), (189.55, 123.77, 16.59)),
}
"""By the name of the scene's folder, in small letters, with _ for -."""
_TABLES = (("mIoU", "miou", 3), ("localization accuracy", "localization", 3), ("minutes of training", "minutes", 2))
_HEAD = "| scene | LangSplat | Feature 3DGS | FAST-Splat | here |\n| --- | --- | --- | --- | --- |"


def figures_of(row: Mapping[str, Any]) -> dict[str, float | None]:
    """What the tables have, of a row that `benchmarks.default_path.measure` made."""
    figures = row["figures"]
    minutes = sum(row["stage_seconds"].values()) / 60
    return {"miou": figures["miou_views"], "localization": figures["localization"], "minutes": minutes}


def tables(measured: Mapping[str, Mapping[str, float | None]]) -> str:
    """Tables 1 to 3 of each data set in Markdown, the paper's figures beside those measured; a scene that was not
    measured is left out, and so is the mean over a data set of which a scene is missing.

    Args:
        measured: `figures_of` each scene, by its name in `PAPER`.
    """
    parts = []
    for data_set in dict.fromkeys(reported.data_set for reported in PAPER.values()):
        scenes = [name for name, reported in PAPER.items() if reported.data_set == data_set]
        there = [name for name in scenes if name in measured]
        for title, key, digits in _TABLES if there else ():
            rows = [(name, (*getattr(PAPER[name], key), measured[name][key])) for name in there]
            if there == scenes and key != "minutes":
                rows.append(("mean", tuple(map(_mean, zip(*(values for _, values in rows), strict=True)))))
            lines = (f"| {name} | {' | '.join(_cell(value, digits) for value in values)} |" for name, values in rows)
            parts.append("\n".join((f"{data_set}: {title}\n", _HEAD, *lines)))
    return "\n\n".join(parts)


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if len(known) == len(values) else None


def _cell(value: float | None, digits: int) -> str:
    return "not measured" if value is None else f"{value:.{digits}f}"
