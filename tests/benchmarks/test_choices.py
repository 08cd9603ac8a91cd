"""A default is replaced only by what is better everywhere, and by more than seeds differ."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from benchmarks.choices.__main__ import CANDIDATES, varied
from benchmarks.choices.discovery import CANDIDATES as DISCOVERY_CANDIDATES
from benchmarks.choices.judging import judge
from benchmarks.choices.objects import CANDIDATES as OBJECT_CANDIDATES
from benchmarks.choices.presets import PLANNER_CANDIDATES, PRESET_CANDIDATES, trials
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.planning import cost_model
from fastsplat.service.planning.cost_model import SceneSize
from fastsplat.service.query import objects
from fastsplat.service.scene import connectivity
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
        ({"tabletop": 5.0}, True),  # one data set is too little
    ],
)
def test_a_default_stands_unless_another_is_better_on_all_data(gains: dict[str, float], stands: bool) -> None:
    judged = judge(_rows(**gains), CANDIDATES)
    assert judged["rates.means"]["stands"] is stands
    assert judged["rates.codes"]["stands"] is True  # nothing was tried


def test_test_views_choose_nothing() -> None:
    rows = _rows(tabletop=0.0, sample=0.0)
    rows |= {f"{data}/test/rates.means=0.006": {"psnr": 99.0, "miou": 1.0} for data in ("tabletop", "sample")}
    assert judge(rows, CANDIDATES)["rates.means"] == judge(_rows(tabletop=0.0, sample=0.0), CANDIDATES)["rates.means"]


def test_candidates_are_settings_and_not_the_defaults() -> None:
    base = TrainingSettings()
    for name, values in CANDIDATES.items():
        for value in values:
            assert varied(base, {name: value}) != base
    with pytest.raises(ValueError, match="no setting is called 'rates"):
        varied(base, {"rates.colors": 1.0})


def test_presets_and_planner_are_varied_within_the_same_time() -> None:
    size = SceneSize(views=40, width=800, height=600, points=4_000, labels=5, exact_labels=True)
    tried = {trial.title: trial.training for trial in trials("skull", size)}
    assert {
        f"balanced/{name}={value:g}" for name, values in PRESET_CANDIDATES["balanced"].items() for value in values
    } <= set(tried)
    for title, training in tried.items():
        TrainingSettings.model_validate(training)
        own = tried[f"{title.split('/')[0]}/default seed=0"]
        assert title.split("/")[1].startswith("default") or {**own, "seed": 0} != {**training, "seed": 0}
    finer, own = tried["balanced/max_side=960"], tried["balanced/default seed=0"]
    assert finer["iterations"] < own["iterations"]
    small = replace(size, width=480, height=360)
    assert not any(trial.title == "balanced/max_side=960" for trial in trials("tabletop", small))  # changes nothing


def test_the_planner_is_as_it_was_after_its_constants_were_varied() -> None:
    tried = list(trials("skull", SceneSize(views=40, width=800, height=600, points=4_000, labels=5)))
    for name, values in PLANNER_CANDIDATES["planner_12s"].items():
        assert not name.startswith("_") or vars(cost_model)[name] not in values
    assert {trial.training["max_sh_degree"] for trial in tried if trial.title.startswith("planner_6s")} == {0, 1, 3}


def test_constants_of_objects_exist_and_are_not_their_own_candidates() -> None:
    for name, values in OBJECT_CANDIDATES.items():
        module, constant = name.split(".")
        own = {"connectivity": connectivity, "objects": objects}[module]
        assert vars(own)[constant] not in values


def test_candidates_of_discovery_are_settings_and_not_the_defaults() -> None:
    defaults = DiscoverySettings()
    for name, values in DISCOVERY_CANDIDATES.items():
        for value in values:
            assert DiscoverySettings.model_validate(defaults.model_dump() | {name: value}) != defaults


def test_the_score_of_other_figures_is_what_it_is_told_to_be() -> None:
    rows = {f"{data}/validation/default seed={seed}": {"counted": 0.9} for data in ("a", "b") for seed in (0, 1)}
    rows |= {"a/validation/x=1": {"counted": 1.0}, "b/validation/x=1": {"counted": 1.0}}
    rows |= {"a/validation/x=2": {"counted": 1.0}, "b/validation/x=2": {"counted": 0.7}}
    rows |= {"b/validation/x=2 seed=1": {"counted": 0.9}}  # seeds are averaged
    judged = judge(rows, {"x": (1, 2), "y": (1,)}, lambda figures: float(figures["counted"]))
    assert judged["x"]["gains"] == {"1": {"a": 0.1, "b": 0.1}, "2": {"a": 0.1, "b": -0.1}}
    assert (judged["x"]["stands"], judged["y"]["stands"]) == (False, True)
