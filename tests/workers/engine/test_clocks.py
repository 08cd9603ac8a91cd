"""Clocks that jump or differ take no job from a worker that lives."""

from __future__ import annotations

import pytest

from fastsplat.workers.engine import heartbeat
from fastsplat.workers.engine.heartbeat import Observer
from tests.workers.deployment import STAGES, Deployment

_JUMP = """
import time
_real, _begin = time.time, time.time()
time.time = lambda: _real() + ({jump} if _real() > _begin + {after} else 0.0)
"""


@pytest.mark.parametrize("jump", [3600.0, -3600.0])
def test_a_clock_that_jumps_takes_no_job_from_a_worker_that_lives(deployment: Deployment, jump: float) -> None:
    operation = deployment.post("training:sleep 8")
    deployment.start_worker(code=_JUMP.format(jump=jump, after=6.0), elsewhere=True)
    deployment.wait_in("training", operation)
    deployment.start_worker(code=_JUMP.format(jump=jump, after=9.0))
    assert deployment.wait_over(operation).state == "SUCCEEDED"
    assert [len(deployment.visits(stage, operation)) for stage in STAGES] == [1, 1, 1, 1]


def test_a_heartbeat_is_as_old_as_it_was_seen_unchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [50.0]
    monkeypatch.setattr(heartbeat, "_seconds", lambda: clock[0])
    observer = Observer()
    observer.look({"dead": 10.0, "alive": 1e12})
    clock[0] = 59.0
    observer.look({"dead": 10.0, "alive": 5.0, "new": 0.0})
    assert observer.stalled(10.0) == frozenset()
    clock[0] = 61.0
    assert observer.stalled(10.0) == {"dead"}
    observer.look({"alive": 5.0})
    assert observer.stalled(10.0) == frozenset()
    clock[0] = 70.0
    assert observer.stalled(10.0) == {"alive"}
