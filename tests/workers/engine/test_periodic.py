"""What a repeated task raises is in the log once: a line for a database that is away, a traceback for a defect."""

from __future__ import annotations

import logging
import threading
from unittest.mock import Mock

import pytest
from sqlalchemy.exc import OperationalError

from fastsplat.workers.engine import periodic
from fastsplat_contract.errors import DatabaseError


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Seconds of the monotonic clock of the log; the filter has forgotten earlier tests."""
    seconds = [0.0]
    monkeypatch.setattr(periodic.time, "monotonic", lambda: seconds[0])
    for log_filter in periodic.logger.filters:
        monkeypatch.setattr(log_filter, "_passed_at", {})
    return seconds


def test_a_defect_is_logged_with_its_traceback_once_a_minute(clock, caplog):
    def defect() -> None:
        {}["missing"]

    for _ in range(5):
        assert not periodic.run_logged("sweep", defect)
    assert len(caplog.records) == 1 and caplog.records[0].levelno == logging.ERROR
    assert caplog.records[0].exc_info is not None and '{}["missing"]' in caplog.text and "sweep" in caplog.text
    clock[0] += 61
    assert not periodic.run_logged("sweep", defect)
    assert len(caplog.records) == 2


def test_another_defect_is_not_hidden_by_the_first(clock, caplog):
    for name, error in (("a", KeyError("x")), ("a", ValueError("x")), ("b", KeyError("x"))):
        periodic.run_logged(name, Mock(side_effect=error))
    assert len(caplog.records) == 3


@pytest.mark.parametrize("error", [DatabaseError("the database is away"), OperationalError("SELECT 1", {}, OSError())])
def test_a_database_that_is_away_is_one_line(error, clock, caplog):
    periodic.run_logged("sweep", Mock(side_effect=error))
    assert len(caplog.records) == 1 and caplog.records[0].exc_info is None
    assert "SELECT" not in caplog.text


def test_a_task_that_ends_well_logs_nothing_and_is_repeated_after_one_that_does_not(clock, caplog, monkeypatch):
    monkeypatch.setattr(periodic, "_PAUSE_AFTER_ERROR_S", 0.0)
    calls, enough = [], threading.Event()

    def task() -> None:
        calls.append(len(calls))
        if len(calls) == 1:
            raise ValueError("once")
        if len(calls) > 2:
            enough.set()
            threading.Event().wait()  # the thread has no other end

    periodic.repeat("task", task, 0.001)
    assert enough.wait(60)
    assert [record.exc_info is not None for record in caplog.records] == [True]
