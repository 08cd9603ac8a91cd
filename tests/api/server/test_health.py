"""Readiness: a finding that costs nothing to ask for, whatever the check behind it does."""

from __future__ import annotations

import asyncio
import threading

import pytest

from fastsplat.api import health
from fastsplat.api.health import Readiness
from fastsplat_contract.errors import NotReadyNowError, ResourceError
from tests.at_once import on_a_loop


def _why(readiness: Readiness) -> str:
    with pytest.raises(NotReadyNowError) as caught:
        readiness.require()
    return caught.value.message


@on_a_loop
async def test_nothing_is_ready_before_the_first_look_and_after_the_drain_began() -> None:
    readiness = Readiness(lambda: None)
    assert not readiness.ready and "first check" in _why(readiness)
    await readiness.look()
    readiness.require()
    readiness.drain()
    await readiness.look()
    assert not readiness.ready and "stop" in _why(readiness)


@on_a_loop
async def test_findings_follow_the_check_and_are_told_once_each() -> None:
    faults: list[Exception | None] = [None, ResourceError("no disk"), ResourceError("no disk"), ValueError("?"), None]
    states: list[bool] = []

    def check() -> None:
        fault = faults.pop(0) if len(faults) > 1 else faults[0]
        if fault is not None:
            raise fault

    readiness = Readiness(check)
    readiness.PERIOD_S = 0.0

    async def changed(ready: bool) -> None:
        states.append(ready)

    task = asyncio.create_task(readiness.watch(changed))
    async with asyncio.timeout(30):
        while len(states) < 3:
            await asyncio.sleep(0.01)
    task.cancel()
    assert states == [True, False, True]


@on_a_loop
async def test_a_check_that_hangs_ends_readiness_and_holds_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(health, "_DEADLINE_S", 0.02)
    release = threading.Event()
    begun: list[int] = []

    def check() -> None:
        begun.append(1)
        release.wait(30)

    readiness = Readiness(check)
    for _ in range(20):
        await readiness.look()
    assert "not ended" in _why(readiness) and len(begun) == 1
    release.set()
    async with asyncio.timeout(30):
        while not readiness.ready:
            await readiness.look()
