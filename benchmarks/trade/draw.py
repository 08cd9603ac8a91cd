"""The picture of the trade."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def draw(rows: list[dict[str, Any]], folder: Path) -> None:
    """`trade.png`."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, all_axes = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
    for axes, up in zip(all_axes, ("psnr_cc", "miou"), strict=True):
        for number, data in enumerate(dict.fromkeys(row["data"] for row in rows)):
            for factor, style in (("tolerance", "o-"), ("recipe", "x--")):
                line = [row for row in rows if row["data"] == data and row["factor"] == factor]
                line.sort(key=lambda row: float(row["cpu_s"]))
                color = f"C{number}"
                axes.plot(
                    [row["cpu_s"] for row in line],
                    [row[up] for row in line],
                    style,
                    label=f"{data}, {factor}",
                    ms=5,
                    color=color,
                )
                for row in line if factor == "tolerance" else ():
                    axes.annotate(row["value"], (row["cpu_s"], row[up]), fontsize="x-small", color=color)
        axes.set(xlabel="CPU seconds of training", ylabel=up, xscale="log")
        axes.grid(alpha=0.3)
    all_axes[1].legend(fontsize="x-small")
    figure.suptitle("what a tolerance buys; crosses: 40,000 Gaussians, nothing decided")
    figure.savefig(folder / "trade.png", dpi=110)
    plt.close(figure)
