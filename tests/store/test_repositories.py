"""Repositories: jobs are created once, fenced by attempt, listed in a stable order."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from operator import attrgetter
from pathlib import Path

import pytest

from fastsplat.service.store.queue.claims import Claim, FencedError
from fastsplat.service.store.rows.database import resolve_url
from fastsplat.service.store.rows.records import NewJob, SceneSummary
from fastsplat.service.store.rows.schema import metadata
from fastsplat.service.store.store import Store, open_store
from fastsplat_contract.errors import DatabaseError, InvalidInputError, NotFoundError
from tests.at_once import at_once

SUMMARY = SceneSummary("v1", 7, "METRIC", ({"label_id": 1, "label": "mug"},), (), {"psnr": 30.0}, 0)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    store = open_store(tmp_path / "data")
    yield store
    store.close()


def job(number: int, request_id: str = "", digest: str = "d") -> NewJob:
    return NewJob(f"scene{number}", f"op{number}", "name", request_id, digest, f"up{number}", {"labels": []})


@pytest.fixture
def claim(store: Store) -> Claim:
    """Of the one job of the store, `job(1)`."""
    store.scenes.create(job(1))
    return store.jobs.claim("op1")


def test_one_request_id_makes_one_operation_whoever_is_faster(store):
    results = at_once(*(partial(store.scenes.create, job(number, "once")) for number in range(8)))
    assert len({record.id for record, _ in results}) == sum(new for _, new in results) == 1
    assert len(store.scenes.list_scenes(100)) == 1


def test_a_newer_claim_fences_every_write_of_the_older(store, claim):
    new = store.jobs.claim("op1")
    assert new.attempt == claim.attempt + 1
    writes = [
        lambda claim: store.jobs.report(claim, [{"stage": "capture"}]),
        lambda claim: store.jobs.check(claim),
        lambda claim: store.jobs.fail(claim, {"reason": "X"}),
        lambda claim: store.jobs.cancelled(claim),
        lambda claim: store.jobs.succeed(claim, SUMMARY),
    ]
    before = store.scenes.operation("op1")
    for write in writes:
        with pytest.raises(FencedError):
            write(claim)
    store.jobs.release(claim)
    assert store.scenes.operation("op1") == before
    store.jobs.succeed(new, SUMMARY)
    scene = store.scenes.scene("scene1")
    assert (scene.state, scene.version, scene.gaussians) == ("READY", "v1", 7)


def test_what_is_over_cannot_be_claimed_or_stopped(store, claim):
    store.jobs.succeed(claim, SUMMARY)
    assert store.jobs.claim("op1") is None
    assert store.scenes.cancel("op1").state == "SUCCEEDED"
    assert store.scenes.scene("scene1").state == "READY"


def test_a_cancellation_that_came_first_wins_over_success(store, claim):
    assert store.scenes.cancel("op1").state == "RUNNING"
    assert store.jobs.check(claim)
    with pytest.raises(FencedError):
        store.jobs.succeed(claim, SUMMARY)
    store.jobs.cancelled(claim)
    assert store.scenes.scene("scene1").state == "CANCELLED"


def test_a_retry_begins_anew_and_an_ended_run_can_neither_claim_nor_write(store, claim):
    store.jobs.report(claim, [{"stage": "capture", "fraction": 1.0, "message": "", "seconds": 1.0, "metrics": {}}])
    store.jobs.fail(claim, {"reason": "WORKER_CRASHED"})
    assert store.scenes.scene("scene1").state == "FAILED"

    again = store.jobs.retry("op1", ended_since=0.0)

    assert (again.state, again.starts, again.stages, again.error, again.retries) == ("QUEUED", 0, [], None, 1)
    assert again.run_id != claim.operation.run_id and store.scenes.scene("scene1").state == "TRAINING"
    assert [record.id for record in store.jobs.in_turn(99)] == ["op1"]
    new = store.jobs.claim("op1")
    for write in (store.jobs.cancelled, lambda claim: store.jobs.succeed(claim, SUMMARY)):
        with pytest.raises(FencedError):
            write(claim)
    store.jobs.succeed(new, SUMMARY)
    assert store.jobs.retry("op1", ended_since=0.0).state == "SUCCEEDED"


def test_a_job_cancelled_in_the_queue_can_be_retried_and_one_that_waits_or_runs_stays_as_it_is(store):
    store.scenes.create(job(1))
    assert store.scenes.cancel("op1").state == "CANCELLED" and store.scenes.scene("scene1").state == "CANCELLED"
    again = store.jobs.retry("op1", ended_since=0.0)
    assert again.state == "QUEUED" and not again.cancel_requested and again.again_after == "cancelled"
    assert store.jobs.retry("op1", ended_since=0.0) == again
    claim = store.jobs.claim("op1")
    assert store.jobs.retry("op1", ended_since=0.0).attempt == claim.attempt


def test_what_has_no_scene_or_no_upload_any_more_is_not_retried(store):
    store.scenes.create(job(1))
    store.scenes.cancel("op1")
    with pytest.raises(NotFoundError):
        store.jobs.retry("op1", ended_since=time.time() + 60)
    assert store.scenes.operation("op1").state == store.scenes.scene("scene1").state == "CANCELLED"
    store.scenes.delete_scene("scene1")
    with pytest.raises(NotFoundError):
        store.jobs.retry("op1", ended_since=0.0)
    with pytest.raises(NotFoundError):
        store.jobs.retry("none", ended_since=0.0)


def test_uploads_of_failed_and_cancelled_jobs_are_needed_for_a_while_and_while_their_scene_is_there(store):
    for number in range(1, 5):
        store.scenes.create(job(number))
    store.jobs.fail(store.jobs.claim("op1"), {})
    store.scenes.cancel("op2")
    store.jobs.succeed(store.jobs.claim("op3"), SUMMARY)
    uploads = {number: store.scenes.operation(f"op{number}").upload_id for number in range(1, 5)}
    unknown = {f"unknown{number}" for number in range(2_500)}  # more than one query asks for
    unneeded = partial(store.jobs.unneeded_uploads, unknown.union(uploads.values()))
    assert unneeded(time.time() - 60) == ({uploads[3]}, unknown)
    assert unneeded(time.time() + 60) == ({uploads[number] for number in (1, 2, 3)}, unknown)
    store.scenes.delete_scene("scene2")
    assert unneeded(time.time() - 60) == ({uploads[2], uploads[3]}, unknown)


def test_success_of_a_deleted_scene_shows_nothing(store):
    store.scenes.create(job(1, "once"))
    claim = store.jobs.claim("op1")
    store.scenes.delete_scene("scene1")
    with pytest.raises(FencedError):
        store.jobs.succeed(claim, SUMMARY)
    assert store.scenes.list_scenes(10) == []
    assert store.scenes.create(job(2, "once", "other"))[1]  # the request id is free again


@pytest.mark.parametrize(
    ("end", "after", "starts"),
    [
        (lambda store, claim: None, "worker_died", 2),
        (lambda store, claim: store.jobs.release(claim), "worker_stopped", 1),
        (lambda store, claim: store.jobs.release(claim, 60.0), "trainer_died", 2),
        (lambda store, claim: store.jobs.cancelled(claim), "cancelled", 1),
        (lambda store, claim: store.jobs.fail(claim, {"reason": "X"}), "failed", 1),
    ],
)
def test_a_job_that_is_begun_again_says_what_ended_the_attempt_before(store, claim, end, after, starts):
    assert claim.operation.again_after is None
    end(store, claim)
    store.jobs.retry("op1", ended_since=0.0)
    again = store.jobs.claim("op1")
    assert (again.operation.again_after, again.operation.starts, again.attempt) == (after, starts, 2)
    newest = store.jobs.claim("op1", "worker")
    assert newest.operation.again_after == "worker_died"  # of a release no word is left
    store.jobs.succeed(newest, SUMMARY)
    attempts = store.jobs.attempts_of(["op1"])["op1"]
    rows = [(attempt.number, attempt.worker, attempt.why) for attempt in attempts]
    assert rows == [(1, "", after), (2, "", "worker_died"), (3, "worker", None)]
    times = [moment for attempt in attempts for moment in (attempt.began_at, attempt.ended_at)]
    assert times == sorted(times)
    store.scenes.delete_scene("scene1")
    store.jobs.delete_ended(time.time() + 60)
    assert store.jobs.attempts_of(["op1"]) == {"op1": ()}


def test_pages_cover_every_scene_once_even_with_equal_times(store, monkeypatch):
    monkeypatch.setattr("fastsplat.service.store.repositories.scene_repository.time.time", lambda: 1000.0)
    for number in range(7):
        store.scenes.create(job(number))
    seen, after = [], None
    while page := store.scenes.list_scenes(3, after):
        seen += [record.id for record in page]
        after = (page[-1].created_at, page[-1].id)
    assert sorted(seen) == [f"scene{number}" for number in range(7)]


def test_stalled_workers_are_known_and_can_be_unregistered(store, monkeypatch):
    clock = [1000.0]
    monkeypatch.setattr("fastsplat.service.store.queue.worker_repository.time.time", lambda: clock[0])

    def stalled() -> list[str]:
        return [worker.executor_id for worker in store.workers.list_workers() if worker.heartbeat_at < clock[0] - 10]

    store.workers.update_heartbeat("a", "host", 1)
    store.workers.update_heartbeat("b", "host", 2)
    assert store.workers.alive(10, "host") == 2 and not store.workers.alive(10, "elsewhere")
    clock[0] = 1020.0
    store.workers.update_heartbeat("b", "host", 2)
    assert stalled() == ["a"]
    store.workers.unregister("a")
    assert stalled() == []
    store.workers.mark_stopped("b")
    assert stalled() == ["b"] and not store.workers.alive(10, "host")


def test_database_urls(tmp_path):
    assert resolve_url(tmp_path, "").database == str(tmp_path / "fastsplat.sqlite")
    assert resolve_url(tmp_path, "postgresql://u:p@h/d").drivername == "postgresql+psycopg"
    with pytest.raises(InvalidInputError) as caught:
        resolve_url(tmp_path, "no url with secret")
    assert "secret" not in str(caught.value)


_CLAIM = object()
_CALLS = {
    "scenes.list_scenes": (1,), "scenes.create": (job(2),), "versions.known": ("scene1", "v1"), "keys.all": (),
    "quota_usage.of": ("key",), "jobs.jobs_by_state": (), "jobs.in_turn": (9,), "jobs.claim_next": ("worker",),
    "jobs.claim": ("op1",), "jobs.attempts_of": (["op1"],), "jobs.owners": (), "jobs.take_back": ("worker",),
    "jobs.release": (_CLAIM,), "jobs.report": (_CLAIM, []), "jobs.check": (_CLAIM,),
    "jobs.succeed": (_CLAIM, SUMMARY), "jobs.fail": (_CLAIM, {}), "jobs.cancelled": (_CLAIM,), "jobs.over": (["op1"],),
    "jobs.delete_ended": (0.0,), "jobs.unneeded_uploads": (["up"], 0.0), "jobs.retry": ("op1", 0.0),
    "jobs.unknown_scenes": (["scene1"],), "workers.update_heartbeat": ("a", "host", 1), "workers.list_workers": (),
    "workers.alive": (10.0,), "workers.mark_stopped": ("a",), "workers.unregister": ("a",),
    "workers._lease": ("cleanup", 60.0),
}  # fmt: skip


@pytest.mark.parametrize("call", _CALLS)
def test_a_database_that_does_not_answer_is_a_typed_error(store, claim, call):
    with store.engine.begin() as connection:
        metadata.drop_all(connection)
    with pytest.raises(DatabaseError) as caught:
        attrgetter(call)(store)(*(claim if argument is _CLAIM else argument for argument in _CALLS[call]))
    assert caught.value.hint and "SELECT" not in caught.value.message
