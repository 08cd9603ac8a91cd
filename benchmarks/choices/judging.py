"""The rule by which a default stands: no other value is better on all data by more than seeds differ."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

_MIOU_DB = 20.0  # one dB and .05 of mean IoU count the same


def quality(figures: Mapping[str, Any]) -> float:
    """PSNR in dB, plus 20 dB times the mean IoU."""
    return float(figures["psnr"] + _MIOU_DB * figures["miou"])


def judge(
    rows: Mapping[str, Mapping[str, Any]],
    candidates: Mapping[str, Sequence[float]],
    score: Callable[[Mapping[str, Any]], float] = quality,
) -> dict[str, dict[str, Any]]:
    """What the validation rows say of each default.

    Args:
        rows: by "DATA/validation/default seed=N" and "DATA/validation/NAME=VALUE", with another seed than 0 followed by
            " seed=N", with what is scored.
        candidates: by setting, the values that were tried beside the default.
        score: of a row's figures; more is better.

    Returns:
        By setting: `gains`, of each candidate the mean score above that of the defaults, by data set; `spread`, the
        range of the defaults' scores over their seeds, by data set; `stands`, whether no candidate is better by more
        than twice that on every data set that it changes, of which there must be two.
    """
    scores: dict[str, dict[str, float]] = {}
    for row, figures in rows.items():
        data, split, title = row.split("/", 2)
        if split == "validation":
            scores.setdefault(data, {})[title] = score(figures)
    defaults = {
        data: [value for title, value in titles.items() if title.startswith("default")]
        for data, titles in scores.items()
    }
    spread = {data: max(values) - min(values) for data, values in defaults.items() if values}
    judged = {}
    for name, values in candidates.items():
        gains: dict[str, dict[str, float]] = {}
        for value in values:
            for data, titles in scores.items():
                tried = [found for title, found in titles.items() if title.split(" seed=")[0] == f"{name}={value:g}"]
                if tried and defaults[data]:
                    gains.setdefault(f"{value:g}", {})[data] = _mean(tried) - _mean(defaults[data])
        better = [len(by) > 1 and all(gain > 2 * spread[data] for data, gain in by.items()) for by in gains.values()]
        judged[name] = {
            "gains": {value: {data: round(gain, 3) for data, gain in by.items()} for value, by in gains.items()},
            "spread": {data: round(value, 3) for data, value in spread.items()},
            "stands": not any(better),
        }
    return judged


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)
