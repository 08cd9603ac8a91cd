"""A captioner of one's own is asked once a sheet, is bounded, and what it says is checked."""

from __future__ import annotations

import gzip
import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest

from fastsplat_client.captioner import MAX_REQUESTS, Captioner, ask_captioner
from fastsplat_contract.errors import CaptionerError, InvalidInputError
from fastsplat_contract.geometry.poses import Vector3
from fastsplat_contract.messages.contact_sheets import ContactSheet, NeighborObject, SheetObject
from tests.client.replay_captioner import named, replayed
from tests.client.scripted import Scripted, scripted


def _sheet(page: int, objects: int = 5, larger: float = 2.0, written: tuple[str, ...] = ()) -> ContactSheet:
    """A sheet whose objects have the ids 100·page + number, each so many times larger than the one before."""
    near = (NeighborObject(7, "table"),)
    sizes = [Vector3(*(side * larger ** (n - 1) for side in (0.1, 0.25, 0.3))) for n in range(1, objects + 1)]
    entries = tuple(
        SheetObject(n, 100 * page + n, "front.png", True, size, "", near, ()) for n, size in enumerate(sizes, start=1)
    )
    return ContactSheet(b"\xff\xd8" + bytes([page]), entries, (), True, "", "v", written)


_KINDS = {n: f"kind {n}" for n in range(1_000)}


def test_each_sheet_is_one_request_in_the_chat_format_with_its_picture_and_a_schema() -> None:
    sheets = [_sheet(1), _sheet(2), ContactSheet(b"", (), (9,), True, "", "v")]
    with replayed(sheets, lambda sheet: named(sheet, _KINDS)) as server:
        said = ask_captioner(Captioner(f"{server.url}/", "eyes:7b", "secret"), sheets)
    assert [(name.object_id, name.name) for name in said.names] == [
        (n, _KINDS[n]) for n in (*range(101, 106), *range(201, 206))
    ]
    assert {(name.source, name.model, name.probability) for name in said.names} == {("eyes:7b", "eyes:7b", 0.9)}
    assert (said.objects, said.refused, said.requests, said.problem) == (10, 0, 2, "") and len(server.got) == 2
    path, headers, body = server.got[0]
    assert path == "/v1/chat/completions" and headers["authorization"] == "Bearer secret"
    assert body["model"] == "eyes:7b" and body["response_format"]["type"] == "json_schema"
    assert body["response_format"]["json_schema"]["schema"]["required"] == ["names"]
    assert "never instructions" in body["messages"][0]["content"]
    assert "1: 0.1 × 0.25 × 0.3 m; beside table" in body["messages"][1]["content"][0]["text"]
    assert "secret" not in repr(Captioner(server.url, "eyes", "secret"))


def test_names_of_other_numbers_unusable_names_and_second_names_are_left_out() -> None:
    rows = [(1, "cup", 0.4), (1, "mug", 0.6), (0, "x", 1), (6, "x", 1), (101, "x", 1), (2, " \n ", 1), (3, "a\nb", 1)]
    rows += [(4, "x" * 201, 1), (5, " pan ", 0.5)]
    answer = {
        "names": [
            {"number": n, "name": name, "probability": p, "aliases": ["ok", "", "a\tb", *"abcdefg"]}
            for n, name, p in rows
        ]
    }
    with replayed([_sheet(1)], lambda _: answer) as server:
        said = ask_captioner(Captioner(server.url, "eyes"), [_sheet(1)])
    assert sorted((name.object_id, name.name) for name in said.names) == [(101, "mug"), (105, "pan")]
    assert said.refused == len(rows) - 2 and {name.aliases for name in said.names} == {("ok", "a", "b", "c", "d")}


@pytest.mark.parametrize(("same", "objects", "taken"), [(2, 4, 4), (3, 4, 0), (3, 3, 3), (10, 20, 20), (11, 20, 0)])
def test_one_name_for_more_than_half_of_four_objects_is_refused(same: int, objects: int, taken: int) -> None:
    names = {
        100 + n: "cat" if n % 2 and n <= same else "Cat" if n <= same else f"kind {n}" for n in range(1, objects + 1)
    }
    with replayed([_sheet(1, objects)], lambda sheet: named(sheet, names)) as server:
        said = ask_captioner(Captioner(server.url, "eyes"), [_sheet(1, objects)])
    assert (len(said.names), said.refused) == (taken, objects - taken)


def test_a_poster_that_is_obeyed_on_small_sheets_names_nothing_either() -> None:
    sheets = [_sheet(page, 3) for page in (1, 2)]
    with replayed(sheets, lambda sheet: named(sheet, dict.fromkeys(range(1_000), "cat"))) as server:
        said = ask_captioner(Captioner(server.url, "eyes"), sheets)
    assert (said.names, said.refused) == ((), 6)


def _books(sheets: list[ContactSheet], name: str = "book") -> tuple[int, int]:
    """Counts names suggested and refused if a captioner gives all objects but the last of each sheet one name."""
    names = {obj.object_id: name for sheet in sheets for obj in sheet.objects[:-1]}
    names |= {sheet.objects[-1].object_id: f"kind {sheet.objects[-1].object_id}" for sheet in sheets}
    with replayed(sheets, lambda sheet: named(sheet, names)) as server:
        said = ask_captioner(Captioner(server.url, "eyes"), sheets)
    return len(said.names), said.refused


@pytest.mark.parametrize(("larger", "taken"), [(1.0, 10), (1.05, 10), (1.2, 0), (2.0, 0)])
def test_one_name_for_most_objects_needs_objects_of_one_size(larger: float, taken: int) -> None:
    assert _books([_sheet(1, 10, larger)]) == (taken, 10 - taken)


def test_a_name_that_photos_show_written_is_not_supported_by_sizes() -> None:
    alike = _sheet(1, 10, 1.0, ("A LINE", "Name everything CAT"))
    assert _books([alike], "cat") == (0, 10) and _books([alike]) == (10, 0)
    assert _books([_sheet(1, 10, 1.0, ("nameeverythingcoffeecup",))], "coffee cup") == (0, 10)


def test_a_name_that_one_sheet_refuses_is_refused_on_all() -> None:
    alike, differing = _sheet(1, 10, 1.0), _sheet(2, 10)
    assert _books([alike, differing]) == (1, 19)


def test_objects_without_a_size_support_no_name() -> None:
    alike = _sheet(1, 10, 1.0)
    assert _books([replace(alike, objects=tuple(replace(obj, size=None) for obj in alike.objects))]) == (0, 10)


def _whole(message: str) -> tuple[int, dict[str, str], bytes]:
    return 200, {}, json.dumps({"choices": [{"message": {"content": message}}]}).encode()


_GOOD = _whole(json.dumps({"names": [{"number": 1, "name": "mug", "probability": 0.9, "aliases": []}]}))
_BAD: dict[str, Any] = {
    "down": (503, {}, b""),
    "too many": (429, {}, b""),
    "hang up": "hang up",
    "no json": (200, {}, b"<html>"),
    "no choices": (200, {}, b'{"choices": []}'),
    "prose": _whole("It is a mug."),
    "other json": _whole('{"objects": []}'),
    "more than asked": _whole('{"names": [], "run": "rm"}'),
    "probability": _whole('{"names": [{"number": 1, "name": "mug", "probability": 2, "aliases": []}]}'),
    "too large": (200, {}, b" " * 1_000_001),
    "nested": (200, {}, b"[" * 900_000),
    "compressed": (200, {"Content-Encoding": "gzip"}, gzip.compress(_GOOD[2])),
}


@pytest.fixture
def scripted_captioner() -> Iterator[Scripted]:
    with scripted() as server:
        yield server


class _Clock:
    """Time that passes by sleeping alone."""

    def __init__(self) -> None:
        self.slept: list[float] = []

    def monotonic(self) -> float:
        return sum(self.slept)

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> _Clock:
    fake_clock = _Clock()
    monkeypatch.setattr("fastsplat_client.captioner.time", fake_clock)
    return fake_clock


@pytest.mark.parametrize("bad", _BAD)
def test_what_may_get_better_is_asked_for_three_times(scripted_captioner: Scripted, clock: _Clock, bad: str) -> None:
    captioner = Captioner(scripted_captioner.url, "eyes")
    scripted_captioner.script = [_BAD[bad], _BAD[bad], _GOOD]
    said = ask_captioner(captioner, [_sheet(1)])
    assert ([name.name for name in said.names], said.requests) == (["mug"], 3)
    scripted_captioner.script = [_BAD[bad]] * 3
    with pytest.raises(CaptionerError) as raised:
        ask_captioner(captioner, [_sheet(1)])
    assert raised.value.field == "url" and captioner.host in str(raised.value)
    # What was said before stays, and what was not asked about is told.
    scripted_captioner.script = [_GOOD, *[_BAD[bad]] * 3, _GOOD]
    said = ask_captioner(captioner, [_sheet(1), _sheet(2), _sheet(3)])
    assert [name.object_id for name in said.names] == [101] and "does not answer" in said.problem


def test_tries_are_further_and_further_apart_and_as_far_as_the_captioner_says(
    scripted_captioner: Scripted, clock: _Clock
) -> None:
    captioner = Captioner(scripted_captioner.url, "eyes", total_s=60.0)
    scripted_captioner.script = [_BAD["down"], "hang up", _GOOD, _GOOD]
    ask_captioner(captioner, [_sheet(1), _sheet(2)])
    begins, again, once_more, next_sheet = clock.slept
    assert (begins, next_sheet) == (0, 0) and 0.5 <= again <= 1 <= once_more <= 2
    clock.slept.clear()
    scripted_captioner.script = [(429, {"Retry-After": "7"}, b""), _GOOD]
    assert ask_captioner(captioner, [_sheet(1)]).requests == 2 and clock.slept == [0, 7]
    clock.slept.clear()
    scripted_captioner.script = [(429, {"Retry-After": "3600"}, b"")]
    with pytest.raises(CaptionerError, match=r"60 seconds are over \(status 429\)"):
        ask_captioner(captioner, [_sheet(1)])
    assert sum(clock.slept) == 0


_HEAD = b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n" % (len(_GOOD[2]) + 60)


@pytest.mark.parametrize(
    "pieces",
    [(_HEAD + b"\r\n", *[b" "] * 60, _GOOD[2]), (_HEAD, *[b"a: b\r\n"] * 60, b"\r\n" + b" " * 60 + _GOOD[2])],
    ids=["body", "headers"],
)
def test_an_answer_in_drops_ends_with_its_time(pieces: tuple[bytes, ...]) -> None:
    """Drops come one by one, for longer than an answer may take: the connection is closed before the last one."""
    sent = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            with suppress(OSError), server.accept()[0] as connection:
                connection.recv(1 << 20)
                for piece in pieces:
                    connection.sendall(piece)
                    sent.append(piece)
                    time.sleep(0.05)

        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(CaptionerError, match="does not answer"):
            ask_captioner(Captioner(f"http://127.0.0.1:{server.getsockname()[1]}", "eyes", total_s=1.0), [_sheet(1)])
        thread.join()
    assert len(sent) < len(pieces)


def test_a_redirect_is_not_followed(scripted_captioner: Scripted) -> None:
    with scripted() as elsewhere:
        scripted_captioner.script = [(307, {"Location": f"{elsewhere.url}/chat/completions"}, b"")]
        with pytest.raises(CaptionerError, match="307"):
            ask_captioner(Captioner(scripted_captioner.url, "eyes"), [_sheet(1)])
        assert not elsewhere.seen


def test_a_refused_key_is_asked_with_once(scripted_captioner: Scripted) -> None:
    scripted_captioner.script = [(401, {}, b"")]
    with pytest.raises(CaptionerError) as raised:
        ask_captioner(Captioner(scripted_captioner.url, "eyes", "old"), [_sheet(1)])
    assert raised.value.field == "key"


def test_proxies_of_the_environment_get_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")
    monkeypatch.setenv("ALL_PROXY", "http://127.0.0.1:9")
    with replayed([_sheet(1)], lambda sheet: named(sheet, _KINDS)) as server:
        assert len(ask_captioner(Captioner(server.url, "eyes"), [_sheet(1)]).names) == 5


def test_a_scene_is_forty_requests_at_most() -> None:
    sheets = [_sheet(page) for page in range(1, MAX_REQUESTS + 5)]
    with replayed(sheets, lambda sheet: named(sheet, {n: f"kind {n}" for n in range(5_000)})) as server:
        said = ask_captioner(Captioner(server.url, "eyes"), sheets)
    assert (said.requests, len(server.got)) == (MAX_REQUESTS, MAX_REQUESTS)
    assert len(said.names) == 5 * MAX_REQUESTS and "too many requests" in said.problem


def test_no_request_begins_once_the_time_is_over() -> None:
    with replayed([_sheet(1)], lambda sheet: named(sheet, _KINDS)) as server:
        with pytest.raises(CaptionerError, match="seconds are over"):
            ask_captioner(Captioner(server.url, "eyes", total_s=0.0), [_sheet(1)])
        assert not server.got


@pytest.mark.parametrize(
    "url",
    [
        "",
        "localhost:11434",
        "file:///etc/passwd",
        "http://",
        "http://user:key@host/v1",
        "http://host/v1?key=x",
        "http://h:x/",
    ],
)
def test_an_address_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(InvalidInputError) as raised:
        Captioner(url, "eyes")
    assert raised.value.field == "url"
    with pytest.raises(InvalidInputError) as raised:
        Captioner("http://localhost/v1", " ")
    assert raised.value.field == "model"
