"""Retries, deadlines and errors of the client, against a server that does what it is told."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fastsplat_client import Client, DeadlineExceededError, RemoteError, Retry, UnreachableError
from fastsplat_client.errors import error_of
from fastsplat_contract.errors import FastSplatError, Kind, NotFoundError
from tests.client.scripted import FINE, OPERATION, Scripted, problem, scripted

_QUICK = Retry(tries=3, first_s=0.01, most_s=0.02)


@pytest.fixture
def server() -> Iterator[Scripted]:
    with scripted() as running:
        yield running


def test_a_call_that_changes_nothing_is_repeated(server: Scripted) -> None:
    server.script = [problem(503, "UNAVAILABLE"), "hang up", FINE]
    with Client(server.url, key="secret", retry=_QUICK) as client:
        assert client.operation("o").state == "QUEUED"
    assert [line for line, _, _ in server.seen] == ["GET /v1/operations/o"] * 3
    assert all(headers["authorization"] == "Bearer secret" for _, headers, _ in server.seen)


def test_there_is_an_end_to_repeating(server: Scripted) -> None:
    server.script = ["hang up"] * 3
    with Client(server.url, retry=_QUICK) as client, pytest.raises(UnreachableError):
        client.operation("o")
    assert len(server.seen) == 3


def test_what_must_not_happen_twice_is_sent_once(server: Scripted) -> None:
    with Client(server.url, retry=_QUICK) as client:
        for step, error in (("hang up", UnreachableError), (problem(503, "UNAVAILABLE"), FastSplatError)):
            server.script = [step]
            with pytest.raises(error):
                client.delete_scene("s")
        assert len(server.seen) == 2
        # A server that turns it away before any work has done nothing.
        server.script = [problem(429, "RATE_LIMITED"), (204, {}, b"")]
        client.delete_scene("s")


def test_refusals_are_not_repeated_and_keep_their_words(server: Scripted) -> None:
    server.script = [problem(404, "NOT_FOUND", field="scene", hint="Look.", request_id="r1")]
    with Client(server.url, retry=_QUICK) as client, pytest.raises(NotFoundError) as caught:
        client.scene("none")
    error = caught.value
    assert (error.message, error.field, error.hint, error.request_id) == ("no", "scene", "Look.", "r1")
    assert len(server.seen) == 1


def test_retry_after_is_obeyed_and_too_long_a_pause_is_none(server: Scripted) -> None:
    busy = problem(429, "RATE_LIMITED")
    with Client(server.url, retry=_QUICK) as client:
        server.script = [(busy[0], {"Retry-After": "0"}, busy[2]), FINE]
        client.operation("o")
        server.script = [(busy[0], {"Retry-After": "3600"}, busy[2])]
        with pytest.raises(FastSplatError) as caught:
            client.operation("o")
    assert caught.value.reason == "RATE_LIMITED" and caught.value.retry_after_s == 3600


def test_an_answer_that_does_not_come_in_time_is_a_deadline(server: Scripted) -> None:
    release = threading.Event()

    def slow() -> Any:
        release.wait(10)
        return FINE

    server.script = [slow]
    with Client(server.url, retry=_QUICK, timeout_s=0.2) as client, pytest.raises(DeadlineExceededError):
        client.operation("o")
    release.set()


def test_a_download_is_taken_up_where_it_broke_off(server: Scripted, tmp_path: Path) -> None:
    content = bytes(range(256)) * 1000
    tag = {"ETag": '"v1"'}
    server.script = [
        (200, {**tag, "cut": 100_000}, content),
        (206, {**tag, "cut": 50_000}, content[100_000:]),
        (206, tag, content[150_000:]),
    ]
    with Client(server.url, retry=_QUICK) as client:
        assert client.download_scene("s", tmp_path / "scene.ply") == '"v1"'
    assert (tmp_path / "scene.ply").read_bytes() == content
    assert [headers.get("range") for _, headers, _ in server.seen] == [None, "bytes=100000-", "bytes=150000-"]

    # Another version became current meanwhile: the server answers with the whole, and that is what the file becomes.
    server.script = [(200, {**tag, "cut": 100_000}, content), (200, {"ETag": '"v2"'}, b"other")]
    with Client(server.url, retry=_QUICK) as client:
        assert client.download_scene("s", tmp_path / "scene.ply") == '"v2"'
    assert (tmp_path / "scene.ply").read_bytes() == b"other"


def test_a_watch_is_taken_up_after_the_last_event(server: Scripted) -> None:
    def event(name: str, state: str, done: bool) -> bytes:
        data = json.dumps({**OPERATION, "state": state, "done": done})
        return f"id: {name}\nevent: operation\ndata: {data}\n\n".encode()

    first, two = event("1", "QUEUED", False), event("2", "SUCCEEDED", True)
    server.script = [(200, {"cut": len(first) + 20}, first + two), "hang up", (200, {}, two)]
    with Client(server.url, retry=_QUICK) as client:
        assert [operation.state for operation in client.watch("o")] == ["QUEUED", "SUCCEEDED"]
    assert [headers.get("last-event-id") for _, headers, _ in server.seen] == [None, "1", "1"]


def test_every_error_of_the_service_comes_back_as_itself() -> None:
    def tree(kind: type[FastSplatError]) -> Iterator[type[FastSplatError]]:
        yield kind
        for below in kind.__subclasses__():
            yield from tree(below)

    for kind in tree(FastSplatError):
        found = error_of(kind.reason, kind.kind, "no", {"field": "f", "limit": "l", "hint": "h"})
        assert found.reason == kind.reason and found.kind is kind.kind
        assert kind.__module__ != "fastsplat_contract.errors" or type(found).reason == kind.reason
        assert found.details() == {"field": "f", "limit": "l", "hint": "h"}
    unknown = error_of("OF_A_LATER_RELEASE", Kind.UNAVAILABLE, "no", {})
    assert isinstance(unknown, RemoteError) and unknown.reason == "OF_A_LATER_RELEASE"
