"""Laws of how good a scene is said to be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.scene.artefact.assessment import assess, viewing_spread_deg
from fastsplat.service.scene.artefact.scene_facts import SceneFacts
from fastsplat_contract.geometry.camera import Camera, PosedCamera

_CAMERA = Camera(width=64, height=48, fx=60.0, fy=60.0, cx=32.0, cy=24.0)
_WELL: Mapping[str, Any] = {
    "images": 40,
    "registered": 40,
    "iterations": 4_000.0,
    "psnr": 30.0,
    "held_out": 5.0,
    "mean_reprojection_error_px": 0.4,
    "train_seconds": 120.2,
    "time_budget_s": 120.0,
    "source": "images",
}
_RANK = {"poor": 0, "fair": 1, "good": 2}


def _around(degrees: float, count: int = 40) -> list[PosedCamera]:
    """Cameras on an arc of a circle that look at its center."""
    return [_looking_in(angle) for angle in np.radians(np.linspace(0, degrees, count))]


def _looking_in(angle: float, *, outward: bool = False) -> PosedCamera:
    toward = np.array([-np.cos(angle), -np.sin(angle), 0.0])
    forward = -toward if outward else toward
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross([0.0, 0, -1], forward), [0.0, 0, -1], forward], axis=1)
    pose[:3, 3] = -3 * toward
    return PosedCamera(_CAMERA, pose)


def test_a_well_made_scene_is_good_and_has_nothing_to_mend() -> None:
    assessment = assess(_WELL, SceneFacts(), _around(180))
    assert (assessment.grade, assessment.findings) == ("good", ())


@pytest.mark.parametrize(
    ("worse", "reason"),
    [
        ({"images": 3, "registered": 3}, "FEW_PHOTOS"),
        ({"registered": 16}, "PHOTOS_NOT_PLACED"),
        ({"iterations": 26.0}, "FEW_STEPS"),
        ({"psnr": 13.7}, "PICTURES_DIFFER"),
    ],
)
def test_what_makes_a_scene_useless_makes_it_poor_with_the_reason_first(worse: Mapping[str, Any], reason: str) -> None:
    assessment = assess({**_WELL, **worse}, SceneFacts(), _around(180))
    assert (assessment.grade, assessment.findings[0].reason) == ("poor", reason)
    assert all(finding.message and finding.advice for finding in assessment.findings)


@given(
    st.fixed_dictionaries(
        {
            "registered": st.integers(0, 40),
            "iterations": st.floats(0, 5_000),
            "psnr": st.floats(5, 40),
            "mean_reprojection_error_px": st.floats(0, 4),
            "train_seconds": st.floats(0, 400),
        }
    ),
    st.sampled_from(["registered", "iterations", "psnr"]),
)
def test_the_grade_is_the_worst_findings_and_more_never_makes_it_worse(measured: Mapping[str, Any], name: str) -> None:
    before = assess({**_WELL, **measured}, SceneFacts(), _around(180))
    after = assess({**_WELL, **measured, name: _WELL[name]}, SceneFacts(), _around(180))
    assert _RANK[after.grade] >= _RANK[before.grade]
    grades = [_RANK[finding.grade] for finding in before.findings]
    assert grades == sorted(grades) and _RANK[before.grade] == min(grades, default=2)


def test_the_psnr_of_views_that_were_trained_on_proves_nothing() -> None:
    assessment = assess({**_WELL, "psnr": 10.0, "held_out": 0.0}, SceneFacts(), _around(180))
    assert assessment is not None and assessment.grade == "good"


def test_a_splat_without_photos_and_a_scene_without_figures_are_not_judged() -> None:
    assert assess(_WELL, SceneFacts(source="splat"), _around(180)) is None
    assert assess({}, SceneFacts(), _around(180)) is None


@pytest.mark.parametrize("degrees", [4.0, 20.0, 90.0, 170.0])
def test_the_spread_of_cameras_on_an_arc_is_the_arc(degrees: float) -> None:
    assert viewing_spread_deg(_around(degrees)) == pytest.approx(degrees, abs=1e-6)


def test_cameras_that_look_outward_or_stand_still_have_no_spread() -> None:
    assert viewing_spread_deg([_looking_in(angle, outward=True) for angle in np.linspace(0, 6, 20)]) is None
    assert viewing_spread_deg(_around(0)) is None  # all axes are one: no point is nearest
    assert viewing_spread_deg(_around(0, 1)) is None


def test_photos_from_one_side_are_said_to_be() -> None:
    assessment = assess(_WELL, SceneFacts(), _around(5))
    assert [finding.reason for finding in assessment.findings] == ["ONE_SIDE_ONLY"]


def test_where_photos_differ_in_exposure_colors_are_aligned_before_they_are_judged() -> None:
    photos = {**_WELL, "psnr": 17.0, "psnr_cc": 29.0}
    assert any(finding.grade == "poor" for finding in assess(photos, SceneFacts(), ()).findings)
    assert not assess({**photos, "photometric": {"a.jpg": [0.4, 0.0, 0.0]}}, SceneFacts(), ()).findings
