"""The picture of the frontier."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def draw(rows: list[dict[str, Any]], folder: Path) -> None:
    """`trade_frontier.png`."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = [row for row in rows if row["factor"].startswith("frontier")]
    figure, all_axes = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
    for axes, up in zip(all_axes, ("psnr", "miou"), strict=True):
        for value in dict.fromkeys(row["value"] for row in rows):
            line = sorted((row for row in rows if row["value"] == value), key=lambda row: float(row["cpu_s"]))
            axes.plot([row["cpu_s"] for row in line], [row[up] for row in line], "o-", label=value, ms=4)
        axes.set(xlabel="CPU seconds of training", ylabel=up, xscale="log")
        axes.grid(alpha=0.3)
    all_axes[1].legend(fontsize="x-small", title="resolution, Gaussians")
    figure.suptitle("tabletop: the same time spent in several ways")
    figure.savefig(folder / "trade_frontier.png", dpi=110)
    plt.close(figure)
