"""Pictures of the frontier."""

from __future__ import annotations

from pathlib import Path
from typing import Any

_SWEPT = ("steps", "resolution", "Gaussians", "harmonics", "code size", "label mode", "fixed recipe")
_QUERIES = ("render stride", "alpha_min", "transmittance_min", "cut-offs together")


def draw(rows: list[dict[str, Any]], folder: Path) -> None:
    """`trade_{tabletop,sample,frontier,query}.png`, as far as there are rows."""
    import matplotlib

    matplotlib.use("Agg")
    for data in ("tabletop", "sample"):
        _sweeps([row for row in rows if row["data"] == data], data, folder / f"trade_{data}.png")
    _frontier([row for row in rows if row["factor"].startswith("frontier")], folder / "trade_frontier.png")
    _queries([row for row in rows if row["factor"] in _QUERIES], folder / "trade_query.png")


def _sweeps(rows: list[dict[str, Any]], data: str, path: Path) -> None:
    import matplotlib.pyplot as plt

    base = next((row for row in rows if row["factor"] == "base"), None)
    if base is None:
        return
    figure, all_axes = plt.subplots(1, 3, figsize=(13, 4.4), layout="constrained")
    for axes, (across, up) in zip(
        all_axes, (("cpu_s", "psnr"), ("cpu_s", "miou"), ("bytes", "boundary_iou")), strict=True
    ):
        for factor in _SWEPT:
            swept = [row for row in rows if row["factor"] == factor]
            if not swept:
                continue
            line = sorted([*swept, base], key=lambda row: float(row[across]))
            scale = 1e-6 if across == "bytes" else 1.0
            axes.plot([row[across] * scale for row in line], [row[up] for row in line], "o-", label=factor, ms=4)
            for row in swept:
                axes.annotate(row["value"], (row[across] * scale, row[up]), fontsize=5, alpha=0.7)
        axes.set(xlabel={"cpu_s": "CPU seconds of training", "bytes": "MB on disk"}[across], ylabel=up, xscale="log")
        axes.grid(alpha=0.3)
    if all_axes[0].lines:
        all_axes[0].legend(fontsize="x-small")
    figure.suptitle(f"{data}: one factor changed at a time")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _frontier(rows: list[dict[str, Any]], path: Path) -> None:
    import matplotlib.pyplot as plt

    if not rows:
        return
    figure, all_axes = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
    for axes, up in zip(all_axes, ("psnr", "miou"), strict=True):
        for value in dict.fromkeys(row["value"] for row in rows):
            line = sorted((row for row in rows if row["value"] == value), key=lambda row: float(row["cpu_s"]))
            axes.plot([row["cpu_s"] for row in line], [row[up] for row in line], "o-", label=value, ms=4)
        axes.set(xlabel="CPU seconds of training", ylabel=up, xscale="log")
        axes.grid(alpha=0.3)
    all_axes[1].legend(fontsize="x-small", title="resolution, Gaussians")
    figure.suptitle("tabletop: the same time spent in several ways")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _queries(rows: list[dict[str, Any]], path: Path) -> None:
    import matplotlib.pyplot as plt

    if not rows:
        return
    figure, all_axes = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
    for axes, (across, up) in zip(all_axes, (("label_map_ms", "miou"), ("colors_ms", "psnr")), strict=True):
        for factor in _QUERIES:
            line = [row for row in rows if row["factor"] == factor]
            axes.plot([row[across] for row in line], [row[up] for row in line], "o-", label=factor, ms=4)
            for row in line:
                axes.annotate(row["value"], (row[across], row[up]), fontsize=6, alpha=0.7)
        axes.set(xlabel=across, ylabel=up)
        axes.grid(alpha=0.3)
    all_axes[0].legend(fontsize="x-small")
    figure.suptitle("tabletop, the base scene: cut-offs and stride when it is drawn")
    figure.savefig(path, dpi=110)
    plt.close(figure)
