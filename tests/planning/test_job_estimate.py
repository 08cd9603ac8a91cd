"""Laws of what photos are expected to take before they are read."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fastsplat.service.planning.cost_model import Speed
from fastsplat.service.planning.job_estimate import PhotoSet, job_seconds
from fastsplat.service.planning.presets import apply_preset
from fastsplat.service.settings import Settings

photo_sets = st.builds(PhotoSet, st.integers(2, 1_000), st.integers(100, 8_000), st.integers(100, 8_000))


@settings(max_examples=40)
@given(photo_sets, st.floats(0.1, 10))
def test_more_photos_and_larger_ones_take_longer_and_faster_machines_are_faster(photos: PhotoSet, speed: float) -> None:
    chosen = Settings()
    measured = Speed(speed, speed, speed)
    here = job_seconds(photos, chosen, measured)
    assert list(here) == ["capture", "perception", "training", "export"] and min(here.values()) > 0
    more = job_seconds(replace(photos, count=photos.count + 40), chosen, measured)
    larger = job_seconds(replace(photos, width=2 * photos.width, height=2 * photos.height), chosen, measured)
    assert all(more[stage] >= here[stage] for stage in here) and more["capture"] > here["capture"]
    assert larger["capture"] > here["capture"]
    faster = job_seconds(photos, chosen, Speed(2 * speed, 2 * speed, 2 * speed))
    assert all(faster[stage] <= here[stage] for stage in here)
    assert faster["capture"] == pytest.approx(here["capture"] / 2)


def test_a_preset_changes_what_is_expected_of_training() -> None:
    photos = PhotoSet(26, 480, 360)
    draft, balanced, best = (
        job_seconds(photos, apply_preset(Settings(), name), Speed()) for name in ("draft", "balanced", "best")
    )
    assert draft["training"] < balanced["training"] < best["training"]
    assert draft["perception"] < balanced["perception"]
    assert draft["capture"] == balanced["capture"] == best["capture"]


def test_the_masks_of_many_photos_are_looked_for_in_some_of_them() -> None:
    few, many = (job_seconds(PhotoSet(count, 4_000, 3_000), Settings(), Speed()) for count in (16, 160))
    assert many["perception"] < 2 * few["perception"] and many["export"] == few["export"]
