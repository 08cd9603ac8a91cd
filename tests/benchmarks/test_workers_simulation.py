"""Simulated workers: alone they do what their jobs' seconds allow; a database that cannot follow bounds them all."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.workers.day import Stored, Supposed, day
from benchmarks.workers.simulation import Costs, simulate

_COSTS = Costs(jobs_s=(100.0, 140.0), turn_s=0.0, job_s=0.0, every_s=2.0, cores=2)


@pytest.mark.parametrize("workers", [1, 40])
def test_with_a_database_that_takes_no_time_every_worker_counts_in_full(workers: int) -> None:
    outcome = simulate(workers, _COSTS)
    assert outcome.jobs_a_day == pytest.approx(workers * 86_400 / 121, rel=0.03)
    assert outcome.of_workers_alone == pytest.approx(1, rel=0.03)
    assert (outcome.database, outcome.longest_turn_s) == (0, 0)


def test_what_the_database_is_asked_is_the_sum_of_turns_and_jobs() -> None:
    outcome = simulate(10, replace(_COSTS, turn_s=0.01, job_s=0.5))
    expected = (10 * 0.01 / 2 + outcome.jobs_a_day / 86_400 * 0.5) / 2
    assert outcome.database == pytest.approx(expected, rel=0.01)


def test_a_busy_database_bounds_jobs_and_delays_heartbeats() -> None:
    costs = replace(_COSTS, job_s=10.0)
    few, many = simulate(10, costs, hours=48), simulate(100, costs, hours=48)
    assert few.jobs_a_day == pytest.approx(10 * 86_400 / 131, rel=0.05) and few.longest_turn_s < 60
    assert many.jobs_a_day == pytest.approx(2 * 86_400 / 10, rel=0.02), "two cores, ten seconds a job"
    assert many.database > 0.99 and many.longest_turn_s > few.longest_turn_s


def test_one_worker_cleans_up_for_all() -> None:
    costs = replace(_COSTS, cleaning_s=3.0)
    for workers in (1, 40):
        assert simulate(workers, costs).database == pytest.approx(3.0 / 60.0 / 2, rel=0.01)


def test_a_part_is_asked_for_its_share_and_the_fullest_bends_first() -> None:
    costs = replace(_COSTS, turn_s=0.001, job_s=0.1, cleaning_s=1.0)
    stored = Stored(100_000, 40.0, 8e6, minute_s=(1.0, 2.0), hour_s=(5.0, 10.0), opening_s=1.5)
    supposed = Supposed(request_s=0.2, names=1_000, bytes_s=1e9, opened=0.02, servers=3)
    few, many = day(1, costs, stored, supposed), day(300, costs, stored, supposed)
    new = few.queue.jobs_a_day
    assert few.shares["cleaning"] == many.shares["cleaning"] == pytest.approx(3.0 / 60)
    assert few.shares["listing"] == many.shares["listing"] == pytest.approx((4_100 * 0.2 + 15.0) / 3_600)
    assert few.shares["store"] == pytest.approx((4 * new + 2_000) * 8e6 / 1e9 / 86_400)
    assert few.shares["opening"] == pytest.approx((new + 2_000) * 1.5 / 6 / 86_400)
    assert few.shares["database"] == few.queue.database and few.first == "listing"
    assert many.first == "opening" and many.shares["opening"] > few.shares["opening"]
