"""Known lengths to a scale with an interval, and a scene scaled by it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.common.combined_ratios import NORMAL_95
from fastsplat.service.scene.artefact.frames import scaled
from fastsplat.service.scene.artefact.scaling import (
    ScaledLength,
    capture_scale_source,
    combined,
    scaling_from_json,
    scaling_to_json,
)
from fastsplat.service.scene.artefact.scene_facts import SceneFacts
from tests.query.box_scenes import BoxShell, orbit, scene_of
from tests.scene.conftest import read_back

_LENGTH = ScaledLength(2.0, 0.01, 0.5, 0.001)


def test_one_length_gives_its_ratio_and_its_own_deviation() -> None:
    scaling = combined([_LENGTH])
    assert scaling.meters_per_unit == pytest.approx(0.25)
    relative = math.hypot(0.01 / 2.0, 0.001 / 0.5)
    assert scaling.deviation == pytest.approx(relative)
    assert scaling.low == pytest.approx(0.25 * math.exp(-NORMAL_95 * relative))
    assert scaling.high == pytest.approx(0.25 * math.exp(NORMAL_95 * relative))


def test_several_lengths_are_weighed_by_how_sure_they_are() -> None:
    sure, unsure = ScaledLength(1.0, 0.002, 0.25, 0.0), ScaledLength(1.0, 0.2, 0.30, 0.0)
    scaling = combined([sure, unsure])
    assert abs(math.log(scaling.meters_per_unit / 0.25)) < 0.001
    assert scaling.deviation < combined([sure]).deviation
    assert combined([sure, sure]).deviation == pytest.approx(combined([sure]).deviation / math.sqrt(2))
    assert combined([unsure, sure]).meters_per_unit == pytest.approx(scaling.meters_per_unit)


def test_lengths_that_contradict_each_other_widen_the_interval() -> None:
    agree = [ScaledLength(1.0, 0.005, 0.250, 0.0), ScaledLength(1.0, 0.005, 0.251, 0.0)]
    contradict = [agree[0], ScaledLength(1.0, 0.005, 0.275, 0.0)]
    assert combined(contradict).deviation > 5 * combined(agree).deviation
    assert combined(contradict).low < 0.25 < 0.275 < combined(contradict).high


@pytest.mark.parametrize("count", [1, 3])
def test_the_interval_has_the_truth_as_often_as_it_says(count: int) -> None:
    rng = np.random.default_rng(3)
    held, rounds = 0, 1_000
    for _ in range(rounds):
        true = rng.uniform(0.5, 4.0, count)
        deviations = true * rng.uniform(0.005, 0.05, count)
        measured = true + rng.normal(0, deviations)
        meters = 0.4 * true + rng.normal(0, 0.002, count)
        scaling = combined(
            [ScaledLength(*map(float, row), 0.002) for row in zip(measured, deviations, meters, strict=True)]
        )
        held += scaling.low <= 0.4 <= scaling.high
    assert 0.93 <= held / rounds <= 0.985


def test_a_scaled_scene_is_the_same_in_other_units() -> None:
    scene = replace(scene_of([BoxShell("box", (0.2, 0.1, 0.0))], orbit()), scale="ARBITRARY")
    scaling = combined([_LENGTH])
    after = scaled(scene, scaling)
    np.testing.assert_allclose(after.gaussians.means, 0.25 * scene.gaussians.means, rtol=1e-6)
    np.testing.assert_allclose(np.exp(after.gaussians.log_scales), 0.25 * np.exp(scene.gaussians.log_scales), rtol=1e-5)
    assert after.scale == "METRIC" and after.scaling == scaling
    assert after.gaussians.sh is scene.gaussians.sh and after.gaussians.quats is scene.gaussians.quats
    for posed, before in zip(after.cameras, scene.cameras, strict=True):
        np.testing.assert_allclose(posed.world_from_camera[:3, 3], 0.25 * before.world_from_camera[:3, 3])
        assert (posed.world_from_camera[:3, :3] == before.world_from_camera[:3, :3]).all()
        assert posed.camera == before.camera  # so that every picture is the same
    again = scaled(after, combined([_LENGTH, ScaledLength(1.0, 0.001, 0.3, 0.0)]))
    np.testing.assert_allclose(again.gaussians.means, again.scaling.meters_per_unit * scene.gaussians.means, rtol=1e-5)


def test_a_scaling_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    scaling = combined([_LENGTH, _LENGTH])
    assert scaling_from_json(scaling_to_json(scaling)) == scaling and scaling_from_json(None) is None
    scene = scaled(scene_of([BoxShell("box", (0.2, 0.1, 0.0))], orbit()), scaling)
    assert read_back(scene, tmp_path / "artefact").scaling == scaling


def test_the_source_of_a_captures_meters_is_the_surest() -> None:
    assert capture_scale_source(SceneFacts(scale_source="sensor_depth")) == "sensor_depth"
    assert capture_scale_source(SceneFacts(scale_source="tags+arkit")) == "tags"
    assert capture_scale_source(SceneFacts()) == "tags"
