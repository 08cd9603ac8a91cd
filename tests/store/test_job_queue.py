"""The queue of jobs: whose turn it is, and who has which; on both databases, whose locks differ."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import pytest
from sqlalchemy import Connection, select
from sqlalchemy.exc import OperationalError

from fastsplat.service.store.queue.claims import FencedError
from fastsplat.service.store.rows.schema import leases, operations
from fastsplat.service.store.store import Store
from tests.at_once import at_once
from tests.store.test_repositories import SUMMARY, job
from tests.waiting import wait_for


def test_projects_take_turns_whatever_the_priorities_of_another(store: Store) -> None:
    for number in range(6):
        project, priority = ("a", 100) if number < 4 else ("b", number - 5)
        store.scenes.create(replace(job(number), project=project, priority=priority))
    listed = store.jobs.in_turn(99), store.jobs.in_turn(1), store.jobs.queued_in_turn()
    foreseen, first, again = ([queued.id for queued in jobs] for jobs in listed)
    assert first == foreseen[:2] and again == foreseen  # the first of each project
    ran = []
    while claim := store.jobs.claim_next("worker"):
        store.jobs.succeed(claim, SUMMARY)
        ran.append(claim.operation.id)
    assert sorted(ran) == [f"op{number}" for number in range(6)]
    assert ran == foreseen == ["op0", "op5", "op1", "op4", "op2", "op3"]  # within a project, by priority and age

    for number in range(10, 18):
        project, priority = ("a", 100) if number < 16 else ("b", 0)
        store.scenes.create(replace(job(number), project=project, priority=priority))
    claims = [store.jobs.claim_next(f"worker{number}") for number in range(4)]
    assert [claim.operation.project for claim in claims] == ["b", "a", "b", "a"]


def test_the_next_is_of_the_project_with_fewest_under_way_and_before_it_what_was_begun(store: Store) -> None:
    for number in range(6):
        store.scenes.create(replace(job(number), project="a" if number < 3 else "b"))
    begun = [store.jobs.claim(f"op{number}", "worker") for number in (0, 1, 3)]
    assert store.jobs.claim_next("worker").operation.id == "op4"  # though the latest of the other is longer ago
    store.jobs.release(begun[0])
    store.jobs.claim("op2", "worker")
    store.scenes.create(replace(job(6), project="c"))
    assert store.jobs.claim_next("worker").operation.id == "op0"  # though nothing of the last project is under way


def test_a_job_is_its_workers_until_that_gives_it_back_or_is_dead(store: Store) -> None:
    for number in (1, 2):
        store.scenes.create(job(number))
    first = store.jobs.claim_next("one")
    assert store.jobs.owners().keys() == {"one"}
    assert store.jobs.claim("op1", "two") is None
    second = store.jobs.claim_next("two")
    assert second.operation.id == "op2" and store.jobs.claim_next("three") is None
    store.jobs.release(first)
    store.jobs.take_back("two")
    assert store.jobs.owners() == {}
    store.scenes.create(replace(job(3), priority=100))
    claims = [store.jobs.claim_next("three") for _ in range(3)]
    assert [claim.operation.id for claim in claims] == ["op1", "op2", "op3"]
    with pytest.raises(FencedError):
        store.jobs.check(second)
    store.jobs.succeed(claims[0], SUMMARY)
    store.jobs.take_back("three")
    with store.engine.connect() as connection:  # what is over stays as it was
        assert connection.scalars(select(operations.c.worker).order_by(operations.c.id)).all() == ["three", "", ""]


def test_a_job_keeps_the_models_that_it_began_with_and_goes_to_who_has_them(store: Store) -> None:
    choice = {"tagger": {"name": "ram:mine", "sha256": {"ram.onnx": "1" * 64}}}
    store.models.choose(choice)
    store.scenes.create(job(1))
    assert store.models.chosen() == choice
    assert store.jobs.claim_next("lacks them", choice, lambda models: not models) is None
    first = store.jobs.claim_next("has them", choice)
    store.jobs.release(first)
    store.models.choose({})
    assert store.models.chosen() == {} and store.jobs.claim_next("lacks them", {}, lambda models: not models) is None
    again = store.jobs.claim_next("has them", {})
    assert first.operation.models == again.operation.models == choice
    store.jobs.fail(again, {})
    store.jobs.retry("op1", 0.0)
    store.scenes.create(job(2))
    looked: list[object] = []
    assert store.jobs.claim_next("lacks them", choice, looked.append) is None and looked == [choice]  # looks once
    assert store.jobs.claim_next("lacks them", {}, lambda models: not models).operation.models == {}


def test_those_that_claim_at_once_have_a_job_each(store: Store) -> None:
    for number in range(6):
        store.scenes.create(replace(job(number), project="ab"[number % 2]))
    claims = at_once(*(partial(store.jobs.claim_next, f"worker{number}") for number in range(6)))
    assert sorted(claim.operation.id for claim in claims) == [f"op{number}" for number in range(6)]
    assert len(store.jobs.owners()) == 6
    store.scenes.create(job(6))
    again = at_once(*[partial(store.jobs.claim, "op6")] * 16)
    assert sorted(claim.attempt for claim in again) == list(range(1, 17))


def test_a_job_whose_trainer_died_is_put_off_while_others_run(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in (1, 2):
        store.scenes.create(job(number))
    store.jobs.release(store.jobs.claim_next("worker"), 60.0)
    assert store.jobs.claim_next("worker").operation.id == "op2" and store.jobs.claim_next("worker") is None
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now + 61)
    again = store.jobs.claim_next("worker").operation
    assert (again.id, again.starts, again.again_after) == ("op1", 2, "trainer_died")


def test_a_job_is_not_put_off_any_more_once_it_is_cancelled_or_if_a_clock_was_ahead(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.scenes.create(job(1))
    store.jobs.release(store.jobs.claim_next("worker"), 60.0)
    store.scenes.cancel("op1")
    claim = store.jobs.claim_next("worker")
    assert store.jobs.check(claim) == {"cancel"}
    now = time.time()
    with monkeypatch.context() as ahead:
        ahead.setattr(time, "time", lambda: now + 3600)
        store.jobs.release(claim, 60.0)
    assert store.jobs.claim_next("worker").operation.id == "op1"


def test_a_job_goes_to_a_worker_that_has_what_it_needs(store: Store) -> None:
    for number, (gpus, memory) in enumerate([(1, 0), (0, 2000), (0, 0)]):
        store.scenes.create(replace(job(number), gpus=gpus, memory=memory))
    offers = [{"memory": 1999}, {"memory": 1999}, {"memory": 2000}, {"memory": 2000}, {"gpus": 1}]
    claims = [store.jobs.claim_next("worker", **offer) for offer in offers]
    assert [claim and claim.operation.id for claim in claims] == ["op2", None, "op1", None, "op0"]
    store.jobs.release(claims[-1])
    assert store.jobs.claim_next("worker") is None  # what it needs it still needs


def test_work_that_all_share_is_done_by_one_at_a_time(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    def take(name: str = "cleanup", seconds: float = 60.0) -> bool:
        with store.workers.leased(name, seconds) as taken:
            return taken

    def leased_until() -> float:
        with store.engine.connect() as connection:
            return connection.scalar(select(leases.c.until).where(leases.c.name == "takes long"))

    assert sorted(at_once(*[take] * 4)) == [False, False, False, True]
    write, lost = store.workers._writing, [0]

    @contextmanager
    def lost_once() -> Iterator[Connection]:
        with write() as connection:
            yield connection
            if lost:
                raise OperationalError("", {}, Exception(lost.pop()))

    with store.workers.leased("takes long", 0.3) as mine:
        monkeypatch.setattr(store.workers, "_writing", lost_once)
        first = leased_until()
        wait_for(lambda: leased_until() > first)  # though the database was away for the first time
        with monkeypatch.context() as patch:
            patch.setattr(time, "time", lambda: first + 0.01)  # the first lease is over
            assert mine and not take("takes long", 0.3)
    clock = [time.time()]
    monkeypatch.setattr(time, "time", lambda: clock[0])
    for step_s, taken in ((61, True), (1, False), (-3600, True)):  # the last by a clock that does not agree
        clock[0] += step_s
        assert take() == taken
