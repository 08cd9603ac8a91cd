"""Limits: what passes them is refused at once, in the words of both protocols, and what was admitted goes on."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import grpc
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status
from hypothesis import given, settings
from hypothesis import strategies as st

from fastsplat.api.access.caller import Principal
from fastsplat.api.access.gate import RateLimiter
from fastsplat.service.settings import LimitSettings
from fastsplat_contract.call import Rule
from fastsplat_contract.errors import OverloadedError, RateLimitedError
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.served import Faces, SlowScenes, on_free_ports, rest_refusal, rpc_refusal, served

_COMPUTES = Rule("read")
_STANDS = Rule("read", long_lived=True)


class _Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def _limiter(**limits: Any) -> tuple[RateLimiter, _Clock]:
    clock = _Clock()
    return RateLimiter(LimitSettings(**limits), clock), clock


def _key(name: str) -> Principal:
    return Principal(name, "default", "editor")


@settings(max_examples=50)
@given(st.lists(st.tuples(st.sampled_from("ab"), st.floats(0, 0.5)), max_size=200))
def test_no_key_gets_more_than_its_burst_and_its_rate(steps: list[tuple[str, float]]) -> None:
    limiter, clock = _limiter(rate_per_s=10, burst=5)
    taken = {"a": 0, "b": 0}
    for name, pause in steps:
        clock.now += pause
        try:
            limiter.enter(_key(name), _COMPUTES).leave()
            taken[name] += 1
        except RateLimitedError:
            pass
        assert taken[name] <= 5 + 10 * clock.now + 1e-6


def test_who_waits_as_long_as_told_gets_in() -> None:
    limiter, clock = _limiter(rate_per_s=4, burst=1)
    limiter.enter(_key("a"), _COMPUTES).leave()
    with pytest.raises(RateLimitedError) as caught:
        limiter.enter(_key("a"), _COMPUTES)
    assert caught.value.retry_after_s == pytest.approx(0.25)
    limiter.enter(_key("b"), _COMPUTES).leave()
    clock.now += caught.value.retry_after_s + 1e-9
    limiter.enter(_key("a"), _COMPUTES).leave()


def test_calls_under_way_are_bounded_by_key_and_together() -> None:
    limiter, _ = _limiter(in_flight=2, admitted=3)
    held = [limiter.enter(_key("a"), _COMPUTES), limiter.enter(_key("a"), _COMPUTES)]
    with pytest.raises(RateLimitedError, match="under way"):
        limiter.enter(_key("a"), _STANDS)
    held.append(limiter.enter(_key("b"), _COMPUTES))
    with pytest.raises(OverloadedError):
        limiter.enter(_key("b"), _COMPUTES)
    held.append(limiter.enter(_key("b"), _STANDS))  # standing calls wait more than they compute
    for entry in held:
        entry.leave()
    assert limiter.admitted == 0
    limiter.enter(_key("a"), _COMPUTES)


def test_one_key_cannot_hold_all_threads_that_take_uploads() -> None:
    limiter, _ = _limiter(uploads=2)
    upload = Rule("editor", long_lived=True, upload=True)
    held = [limiter.enter(_key("a"), upload), limiter.enter(_key("a"), upload)]
    with pytest.raises(RateLimitedError, match="uploads"):
        limiter.enter(_key("a"), upload)
    limiter.enter(_key("a"), _COMPUTES).leave()
    limiter.enter(_key("b"), upload).leave()
    held.pop().leave()
    limiter.enter(_key("a"), upload)


def test_refusals_cost_no_tokens() -> None:
    limiter, _ = _limiter(rate_per_s=0.001, burst=2, in_flight=1)
    entry = limiter.enter(_key("a"), _COMPUTES)
    for _ in range(10):
        with pytest.raises(RateLimitedError):
            limiter.enter(_key("a"), _COMPUTES)
    entry.leave()
    limiter.enter(_key("a"), _COMPUTES)


@pytest.fixture
def crowded() -> Iterator[tuple[Faces, SlowScenes, list[Any]]]:
    """Two admitted calls that compute, one over each protocol, and no room for a third."""
    service = SlowScenes()
    limits = LimitSettings(admitted=2, in_flight=50, burst=50, rate_per_s=0.5)
    with served(service, on_free_ports(limits=limits)) as faces:
        answers: list[Any] = []
        over_rest = threading.Thread(target=lambda: answers.append(faces.rest.get("/v1/scenes/x").status_code))
        over_grpc = faces.rpc.GetScene.future(pb.GetSceneRequest(scene_id="x"))
        over_rest.start()
        for _ in range(2):
            assert service.running.acquire(timeout=30)
        try:
            yield faces, service, answers
        finally:
            service.release.set()
            over_rest.join(30)
            assert over_grpc.exception().code() == grpc.StatusCode.NOT_FOUND
            assert answers == [404]


def test_a_full_house_refuses_at_once_and_lives(crowded: tuple[Faces, SlowScenes, list[Any]]) -> None:
    faces, _, answers = crowded
    refused = faces.rest.get("/v1/scenes/x")
    assert rest_refusal(refused).reason == "OVERLOADED" and refused.status_code == 503
    assert int(refused.headers["retry-after"]) >= 1
    with pytest.raises(grpc.RpcError) as caught:
        faces.rpc.GetScene(pb.GetSceneRequest(scene_id="x"), timeout=20)
    assert rpc_refusal(caught.value).reason == "OVERLOADED"
    assert caught.value.code() == grpc.StatusCode.RESOURCE_EXHAUSTED
    assert faces.rest.get("/livez").status_code == faces.rest.get("/readyz").status_code == 200
    assert not answers


def test_too_many_calls_are_told_when_to_come_again(crowded: tuple[Faces, SlowScenes, list[Any]]) -> None:
    faces, _, _ = crowded
    for _ in range(200):  # two tokens are gone; an unknown path takes one and computes nothing
        refused = faces.rest.get("/nothing")
        if refused.status_code != 404:
            break
    assert rest_refusal(refused).reason == "RATE_LIMITED" and refused.status_code == 429
    assert "FASTSPLAT_LIMITS__RATE_PER_S" in rest_refusal(refused).details["limit"]
    assert 1 <= int(refused.headers["retry-after"]) <= 3
    with pytest.raises(grpc.RpcError) as caught:
        faces.rpc.GetScene(pb.GetSceneRequest(scene_id="x"), timeout=20)
    assert rpc_refusal(caught.value).reason == "RATE_LIMITED"
    status = rpc_status.from_call(caught.value)
    retry = error_details_pb2.RetryInfo()
    assert status.details[1].Unpack(retry) and 0 < retry.retry_delay.ToNanoseconds() <= 2e9
    assert {faces.rest.get(path).status_code for path in ("/livez", "/readyz") for _ in range(20)} == {200}
