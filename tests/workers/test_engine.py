"""What a worker relies on in the job engine, and what the engine keeps between releases."""

from __future__ import annotations

import inspect

import pytest
from dbos import DBOS

from fastsplat.workers.claimed_job import CANCELLED, DONE, JobOutcome, failed
from fastsplat.workers.heartbeat import recover_jobs_of


def test_the_engine_has_the_internal_method_that_recovers_a_dead_executors_jobs(monkeypatch) -> None:
    assert list(inspect.signature(DBOS._recover_pending_workflows).parameters) == ["executor_ids"]
    calls: list[list[str]] = []
    monkeypatch.setattr(DBOS, "_recover_pending_workflows", calls.append)
    recover_jobs_of("host-1-aa")
    assert calls == [["host-1-aa"]]


_ERROR = {"kind": "INTERNAL", "reason": "X", "message": "m", "stage": "training", "details": {}}


@pytest.mark.parametrize(
    ("recorded", "outcome"),
    [
        ({"outcome": "done"}, DONE),
        ({"outcome": "cancelled"}, CANCELLED),
        ({"outcome": "failed", "error": _ERROR}, failed(_ERROR)),
    ],
)
def test_recorded_stages_of_earlier_releases_can_be_read_and_are_written_the_same(recorded, outcome) -> None:
    assert JobOutcome.from_json(recorded) == outcome
    assert outcome.to_json() == recorded
