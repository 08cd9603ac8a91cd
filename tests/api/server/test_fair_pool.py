"""Threads go round robin over callers; what nobody waits for is not run."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import Future

import pytest

from fastsplat.api.fair_pool import FairPool
from tests.waiting import wait_for


@pytest.fixture
def pool() -> Iterator[FairPool]:
    pool = FairPool(3, "test")
    yield pool
    pool.close()


def test_one_caller_never_has_every_thread(pool: FairPool) -> None:
    release, begun = threading.Event(), threading.Semaphore(0)

    def hold() -> None:
        begun.release()
        assert release.wait(30)

    held = [pool.submit("greedy", hold) for _ in range(20)]
    assert all(begun.acquire(timeout=30) for _ in range(2))
    assert pool.submit("other", lambda: "answered").result(30) == "answered"
    assert not any(future.done() for future in held)
    release.set()
    assert [future.result(30) for future in held] == [None] * 20


def test_callers_take_turns_however_much_one_has_queued() -> None:
    pool = FairPool(1, "turns")
    running, release, order = threading.Event(), threading.Event(), []
    first = pool.submit("a", lambda: (running.set(), release.wait(30)))
    assert running.wait(30)  # else it is taken between those that are queued, and the turns begin elsewhere
    queued = [pool.submit(caller, lambda caller=caller: order.append(caller)) for caller in "aaaabbc"]
    release.set()
    for future in (first, *queued):
        future.result(30)
    assert "".join(order) == "abcabaa"
    pool.close()


def _hold(pool: FairPool) -> tuple[threading.Event, list[Future[bool]]]:
    """Calls that have begun and take all that one caller gets, until they are released."""
    begun, release = threading.Barrier(3), threading.Event()

    def hold() -> bool:
        begun.wait(60)
        return release.wait(60)

    held = [pool.submit("a", hold) for _ in range(2)]
    begun.wait(60)
    return release, held


def test_a_cancelled_call_is_not_run_and_holds_nothing(pool: FairPool) -> None:
    (release, held), ran = _hold(pool), []
    given_up = [pool.submit("a", lambda: ran.append(1)) for _ in range(100)]
    for future in given_up:
        assert future.cancel()
    assert not any(pool._callers["a"].waiting)
    release.set()
    for future in held:
        future.result(30)
    assert pool.submit("a", lambda: "next").result(30) == "next" and not ran


def test_an_error_is_the_calls_own_and_closing_cancels_what_waits(pool: FairPool) -> None:
    with pytest.raises(ZeroDivisionError):
        pool.submit("a", lambda: 1 / 0).result(30)
    release, held = _hold(pool)
    waiting = pool.submit("a", lambda: None)
    closing = threading.Thread(target=pool.close)
    closing.start()
    wait_for(waiting.done)
    assert waiting.cancelled()
    release.set()
    closing.join(30)
    assert all(future.result(30) for future in held)
    with pytest.raises(RuntimeError):
        pool.submit("a", lambda: None)


def test_calls_in_the_background_leave_a_thread_to_the_callers_other_calls() -> None:
    pool = FairPool(1, "classes")
    release = threading.Event()
    long = pool.submit("a", lambda: release.wait(30), background=True)
    assert pool.submit("a", lambda: "short").result(30) == "short"
    release.set()
    assert long.result(30)
    pool.close()


def test_who_is_over_its_share_while_others_call_goes_to_the_background() -> None:
    now = [0.0]
    pool = FairPool(4, "share", clock=lambda: now[0])
    release, begun = threading.Event(), threading.Event()

    def name() -> str:
        return threading.current_thread().name.rpartition("_")[0]

    def work() -> None:
        begun.set()
        assert release.wait(30)

    pool.submit("loud", work)
    assert begun.wait(30)
    now[0] = 5.0
    assert pool.submit("loud", name).result(30) == "share"  # nobody else calls
    assert pool.submit("quiet", name).result(30) == "share"
    assert pool.submit("loud", name).result(30) == "share_background"
    assert pool.submit("quiet", name).result(30) == "share"
    release.set()
    wait_for(lambda: not pool._callers)
    now[0] = 100.0
    assert pool.submit("quiet", name).result(30) == "share"
    assert pool.submit("loud", name).result(30) == "share"  # long forgotten
    pool.close()
