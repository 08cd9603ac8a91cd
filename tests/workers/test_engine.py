"""What a worker relies on in the job engine, and what the engine keeps between releases."""

from __future__ import annotations

import inspect
from types import SimpleNamespace

import pytest
from dbos import DBOS, _queue, _workflow_commands
from dbos._dbos import DBOSRegistry
from dbos._sys_db import SystemDatabase
from dbos._sys_db_postgres import BACKGROUND_JOB_LOCK_IDLE_TIMEOUT_MS
from dbos._utils import retriable_postgres_exception
from sqlalchemy import create_engine
from sqlalchemy.exc import OperationalError

from fastsplat.workers.claimed_job import CANCELLED, DONE, JobOutcome, failed
from fastsplat.workers.engine import remember_queues, retry_refused_connections, slow_down_housekeeping
from fastsplat.workers.heartbeat import recover_jobs_of


def test_the_engine_has_the_internal_method_that_recovers_a_dead_executors_jobs(monkeypatch) -> None:
    assert list(inspect.signature(DBOS._recover_pending_workflows).parameters) == ["executor_ids"]
    calls: list[list[str]] = []
    monkeypatch.setattr(DBOS, "_recover_pending_workflows", calls.append)
    recover_jobs_of("host-1-aa")
    assert calls == [["host-1-aa"]]


def test_the_engine_has_the_internals_that_make_an_idle_worker_cheap(monkeypatch) -> None:
    registry = DBOSRegistry()
    before = registry.get_internal_queue()._polling_interval_sec
    name = "_BACKGROUND_JOBS_INTERVAL_SEC"
    monkeypatch.setattr(_workflow_commands, name, getattr(_workflow_commands, name))
    assert "_BACKGROUND_JOBS_INTERVAL_SEC" in inspect.getsource(_workflow_commands.background_jobs_thread)
    slow_down_housekeeping(SimpleNamespace(_registry=registry))
    assert registry.get_internal_queue()._polling_interval_sec > before
    assert 1000 * _workflow_commands._BACKGROUND_JOBS_INTERVAL_SEC < BACKGROUND_JOB_LOCK_IDLE_TIMEOUT_MS


def test_the_engine_lists_its_queues_from_memory_once_there_are_any(monkeypatch) -> None:
    assert "dbos._sys_db.list_queues(" in inspect.getsource(_queue.queue_thread)
    assert "application_name" in inspect.signature(SystemDatabase.list_queues).parameters
    answers, clock = [[], ["scenes"], ["scenes", "others"]], [100.0]
    monkeypatch.setattr("fastsplat.workers.engine.time.monotonic", lambda: clock[0])
    database = SimpleNamespace(list_queues=lambda *, application_name: answers.pop(0))
    remember_queues(database, 60.0)
    assert [database.list_queues(application_name="a") for _ in range(3)] == [[], ["scenes"], ["scenes"]]
    clock[0] += 61.0
    assert database.list_queues(application_name="a") == ["scenes", "others"]


@pytest.mark.parametrize("address", ["@:5432/a?host=/nowhere", "@name.invalid:5432/a", "@127.0.0.1:1/a"])
def test_the_engine_tries_again_when_the_database_cannot_be_reached(address: str) -> None:
    retry_refused_connections()
    engine = create_engine(f"postgresql+psycopg://user{address}")
    with pytest.raises(OperationalError) as caught:
        engine.connect()
    assert retriable_postgres_exception(caught.value)


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
