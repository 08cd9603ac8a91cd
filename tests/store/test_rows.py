"""Rows: admitted once, fenced by attempt, listed in a stable order."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from fastsplat.service.store import Store, open_store
from fastsplat.service.store.engine import resolve_url
from fastsplat.service.store.jobs import FencedError
from fastsplat.service.store.records import NewJob, SceneSummary
from fastsplat_contract.errors import ConflictError, DatabaseError, InvalidInputError, NotFoundError

SUMMARY = SceneSummary("v1", 7, "METRIC", ({"label_id": 1, "label": "mug"},), (), {"psnr": 30.0})


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    store = open_store(tmp_path / "data")
    yield store
    store.close()


def job(number: int, request_id: str = "", digest: str = "d") -> NewJob:
    return NewJob(f"scene{number}", f"op{number}", "name", request_id, digest, f"up{number}", {"labels": []})


def test_admitted_is_there_for_everybody_at_once(store, tmp_path):
    store.rows.admit(job(1))
    other = open_store(tmp_path / "data")
    assert other.rows.operation("op1").state == "QUEUED"
    assert other.rows.scene("scene1").state == "TRAINING"
    other.close()


def test_one_request_id_makes_one_operation_whoever_is_faster(store):
    barrier = threading.Barrier(8)

    def admit(number: int) -> tuple[str, bool]:
        barrier.wait()
        record, new = store.rows.admit(job(number, "once"))
        return record.id, new

    with ThreadPoolExecutor(8) as pool:
        results = list(pool.map(admit, range(8)))
    assert len({operation_id for operation_id, _ in results}) == 1
    assert sum(new for _, new in results) == 1
    assert len(store.rows.scenes(100)) == 1


def test_one_request_id_for_other_content_is_a_conflict(store):
    store.rows.admit(job(1, "once", "first"))
    with pytest.raises(ConflictError, match="once"):
        store.rows.admit(job(2, "once", "second"))
    assert len(store.rows.scenes(100)) == 1


def test_without_a_request_id_every_request_is_new(store):
    assert [store.rows.admit(job(number))[1] for number in range(3)] == [True, True, True]


def test_unknown_ids_are_not_found(store):
    with pytest.raises(NotFoundError):
        store.rows.operation("nothing")
    for call in (store.rows.scene, store.rows.delete_scene):
        with pytest.raises(NotFoundError):
            call("nothing")


def test_a_newer_claim_fences_every_write_of_the_older(store):
    store.rows.admit(job(1))
    old = store.jobs.claim("op1")
    new = store.jobs.claim("op1")
    assert old is not None and new is not None and new.attempt == old.attempt + 1
    writes = [
        lambda claim: store.jobs.report(claim, [{"stage": "capture"}]),
        lambda claim: store.jobs.check(claim),
        lambda claim: store.jobs.fail(claim, {"reason": "X"}),
        lambda claim: store.jobs.cancelled(claim),
        lambda claim: store.jobs.succeed(claim, SUMMARY),
    ]
    before = store.rows.operation("op1")
    for write in writes:
        with pytest.raises(FencedError):
            write(old)
    store.jobs.release(old)
    assert store.rows.operation("op1") == before
    store.jobs.succeed(new, SUMMARY)
    scene = store.rows.scene("scene1")
    assert (scene.state, scene.version, scene.gaussians) == ("READY", "v1", 7)


def test_what_is_over_cannot_be_claimed_or_stopped(store):
    store.rows.admit(job(1))
    claim = store.jobs.claim("op1")
    store.jobs.succeed(claim, SUMMARY)
    assert store.jobs.claim("op1") is None
    assert store.rows.cancel("op1").state == "SUCCEEDED"
    assert store.rows.scene("scene1").state == "READY"


def test_a_cancellation_that_came_first_wins_over_success(store):
    store.rows.admit(job(1))
    claim = store.jobs.claim("op1")
    assert store.rows.cancel("op1").state == "RUNNING"
    assert store.jobs.check(claim)
    with pytest.raises(FencedError):
        store.jobs.succeed(claim, SUMMARY)
    store.jobs.cancelled(claim)
    assert store.rows.scene("scene1").state == "FAILED"


def test_success_of_a_deleted_scene_shows_nothing(store):
    store.rows.admit(job(1, "once"))
    claim = store.jobs.claim("op1")
    store.rows.delete_scene("scene1")
    with pytest.raises(FencedError):
        store.jobs.succeed(claim, SUMMARY)
    assert store.rows.scenes(10) == []
    assert store.rows.admit(job(2, "once", "other"))[1]  # the request id is free again


def test_a_release_takes_the_start_back_but_not_the_fence(store):
    store.rows.admit(job(1))
    claim = store.jobs.claim("op1")
    store.jobs.release(claim)
    again = store.jobs.claim("op1")
    assert (again.operation.starts, again.attempt) == (1, 2)


def test_pages_cover_every_scene_once_even_with_equal_times(store, monkeypatch):
    monkeypatch.setattr("fastsplat.service.store.rows.time.time", lambda: 1000.0)
    for number in range(7):
        store.rows.admit(job(number))
    seen, after = [], None
    while page := store.rows.scenes(3, after):
        seen += [record.id for record in page]
        after = (page[-1].created_at, page[-1].id)
    assert sorted(seen) == [f"scene{number}" for number in range(7)]


def test_silent_workers_are_found_and_buried(store, monkeypatch):
    clock = [1000.0]
    monkeypatch.setattr("fastsplat.service.store.jobs.time.time", lambda: clock[0])

    def silent() -> list[str]:
        return [worker.executor_id for worker in store.jobs.workers() if worker.silent(10, clock[0])]

    store.jobs.beat("a", "host", 1)
    store.jobs.beat("b", "host", 2)
    clock[0] = 1020.0
    store.jobs.beat("b", "host", 2)
    assert silent() == ["a"]
    store.jobs.bury("a")
    assert silent() == []
    store.jobs.resign("b")
    assert silent() == ["b"]


def test_many_threads_write_without_losing_anything(store):
    store.rows.admit(job(1))
    with ThreadPoolExecutor(16) as pool:
        claims = list(pool.map(lambda _: store.jobs.claim("op1"), range(64)))
    assert sorted(claim.attempt for claim in claims) == list(range(1, 65))


def test_database_urls(tmp_path):
    assert resolve_url(tmp_path, "", sqlite_name="x.sqlite").database == str(tmp_path / "x.sqlite")
    assert resolve_url(tmp_path, "postgresql://u:p@h/d", sqlite_name="x").drivername == "postgresql+psycopg"
    with pytest.raises(InvalidInputError) as caught:
        resolve_url(tmp_path, "no url with secret", sqlite_name="x")
    assert "secret" not in str(caught.value)


def test_records_are_values(store):
    record, _ = store.rows.admit(job(1))
    assert replace(record) == store.rows.operation("op1")


def test_a_database_that_does_not_answer_is_a_typed_error(store):
    with store.engine.begin() as connection:
        connection.exec_driver_sql("DROP TABLE scenes")
    with pytest.raises(DatabaseError) as caught:
        store.rows.scenes(1)
    assert caught.value.hint and "SELECT" not in caught.value.message
