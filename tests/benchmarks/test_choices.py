"""A default is replaced only by what is better everywhere, and by more than seeds differ."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks.choices.__main__ import CANDIDATES, judge, varied
from fastsplat.service.splatting.settings import TrainingSettings


def _rows(**gains: float) -> dict[str, dict[str, Any]]:
    rows: dict[str, dict[str, Any]] = {}
    for data, gain in gains.items():
        for seed, psnr in enumerate((29.9, 30.0, 30.1)):
            rows[f"{data}/validation/default seed={seed}"] = {"psnr": psnr, "miou": 0.9}
        rows[f"{data}/validation/rates.means=0.006"] = {"psnr": 30.0 + gain, "miou": 0.9}
    return rows


@pytest.mark.parametrize(
    ("gains", "stands"),
    [
        ({"tabletop": 0.5, "sample": 0.5}, False),
        ({"tabletop": 0.5, "sample": 0.3}, True),  # within twice the spread of the seeds, .2 dB
        ({"tabletop": 5.0, "sample": -0.1}, True),
    ],
)
def test_a_default_stands_unless_another_is_better_on_all_data(gains: dict[str, float], stands: bool) -> None:
    judged = judge(_rows(**gains))
    assert judged["rates.means"]["stands"] is stands
    assert judged["rates.codes"]["stands"] is True  # nothing was tried


def test_test_views_choose_nothing() -> None:
    rows = _rows(tabletop=0.0, sample=0.0)
    rows |= {f"{data}/test/rates.means=0.006": {"psnr": 99.0, "miou": 1.0} for data in ("tabletop", "sample")}
    assert judge(rows)["rates.means"] == judge(_rows(tabletop=0.0, sample=0.0))["rates.means"]


def test_candidates_are_settings_and_not_the_defaults() -> None:
    base = TrainingSettings()
    for name, values in CANDIDATES.items():
        for value in values:
            assert varied(base, {name: value}) != base
    with pytest.raises(ValueError, match="no setting is called 'rates"):
        varied(base, {"rates.colors": 1.0})
