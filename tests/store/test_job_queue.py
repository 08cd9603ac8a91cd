"""The queue of jobs: whose turn it is, and who has which; on both databases, whose locks differ."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import pytest

from fastsplat.service.store.queue.claims import FencedError
from fastsplat.service.store.store import Store
from tests.at_once import at_once
from tests.store.test_repositories import SUMMARY, job


def test_projects_take_turns_whatever_the_priorities_of_another(store: Store) -> None:
    for number in range(6):
        project, priority = ("a", 100) if number < 4 else ("b", number - 5)
        store.scenes.create(replace(job(number), project=project, priority=priority))
    foreseen = [record.id for record in store.jobs.in_turn()]
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
    assert [store.jobs.claim_next("three").operation.id for _ in range(3)] == ["op1", "op2", "op3"]
    with pytest.raises(FencedError):
        store.jobs.check(second)


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


def test_two_that_claim_at_once_have_different_jobs(store: Store) -> None:
    for number in range(6):
        store.scenes.create(job(number))

    def claim(number: int) -> str:
        while (claim := store.jobs.claim_next(f"worker{number}")) is None:
            pass
        return claim.operation.id

    assert sorted(at_once(*(partial(claim, number) for number in range(6)))) == [f"op{number}" for number in range(6)]
    assert len(store.jobs.owners()) == 6
