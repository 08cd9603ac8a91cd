"""An assistant's tools under hostile arguments, names and callers: bounded, typed, and ended with who asked."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import sys
import threading
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

import pytest
from mcp import Client as McpClient
from mcp import StdioServerParameters, stdio_client
from mcp_types import CallToolResult

from fastsplat.service.application.answering.answers import Answers
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat_client import Client
from fastsplat_client.assistant.tools import list_scenes, resolve_scene
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.messages.scenes import SceneSummary
from tests.api.clients import client_of
from tests.api.guarded import Guarded
from tests.api.made_scene import add_scene
from tests.api.programs.test_assistant import _call, _refusal, _said, _talk
from tests.api.served import Faces


@pytest.mark.parametrize(
    ("tool", "arguments", "field"),
    [
        ("find", {}, "text"),
        ("find", {"text": 7}, "text"),
        ("find", {"text": "mug", "scen": "made"}, "scen"),
        ("find", {"text": "mug", "scene": "x" * 1_000}, "scene"),
        ("list_objects", {"limit": 10**9}, "limit"),
        ("measure", {"first": -1}, "first"),
        ("measure", {"first": 2**70}, "first"),
        ("look_from", {"position": [0, 0, float("nan")], "target": [0, 0, 1]}, "position.2"),
        ("look_from", {"position": [0, 0, 0], "target": [0, 0, float("inf")]}, "target.2"),
        ("erase_everything", {}, "name"),
    ],
)
def test_a_refusal_names_the_argument_and_quotes_nothing(
    faces: Faces, tool: str, arguments: dict[str, Any], field: str
) -> None:
    headers = {"Content-Type": "application/json", "Accept": "application/json, text/event-stream"}
    body = {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": tool, "arguments": arguments}}
    response = faces.rest.post("/mcp", content=json.dumps(body).encode(), headers=headers)
    (content,) = response.json()["result"]["content"]
    assert content["text"].startswith("INVALID_INPUT: ") and f"field: {field}" in content["text"]
    assert len(content["text"]) < 1_000 and "pydantic" not in content["text"] and "xxx" not in content["text"]


def test_a_name_that_a_person_gave_is_replaced_only_by_who_names_it(guarded: Guarded) -> None:
    scene_id = add_scene(guarded.service, guarded.settings, "named by a person")
    editor = guarded.header("editor")
    with client_of(guarded.faces, key=guarded.keys["editor"]) as person:
        person.name_objects(scene_id, 1, "sphere")
    version = guarded.service.get_scene(scene_id).version
    for replaces in ({}, {"replaces": "mug"}):
        refusal = _refusal(
            _call(guarded.faces, "name_object", editor, object_id=1, name="beaker", scene=scene_id, **replaces)
        )
        assert "CONFLICT: a person has named object 1" in refusal
    assert guarded.service.get_scene(scene_id).version == version
    said = _said(
        _call(guarded.faces, "name_object", editor, object_id=1, name="beaker", replaces="Sphere", scene=scene_id)
    )
    assert said["version"] != version


class _Many:
    """A service with more of everything than a model should read."""

    scene = "a"

    def __init__(self, objects: int) -> None:
        self.count = objects

    def scenes(self) -> Any:
        at = datetime(2026, 1, 1, tzinfo=UTC)
        summary = SceneSummary("s", "sample \u202eroom\n", "READY", "o", at, 1, "METRIC", "1", 1, None, None)
        return (replace(summary, id=f"s{number}") for number in range(self.count))


def test_hostile_names_of_scenes_stay_on_one_line() -> None:
    with pytest.raises(InvalidInputError) as raised:
        resolve_scene(cast(Client, _Many(3)), "")
    assert "s0 (sample  room )" in raised.value.hint and "\u202e" not in raised.value.hint


def test_what_is_left_out_is_said() -> None:
    listed = list_scenes(cast(Client, _Many(1_000)))
    assert (len(listed.scenes), listed.more) == (200, 800)


def test_calls_at_once_are_all_answered(faces: Faces, scene_id: str) -> None:
    """As many as one key may have under way: each is one, and what it asks is another."""

    async def talk(client: McpClient) -> list[CallToolResult]:
        calls = [client.call_tool("find", {"text": text, "scene": scene_id}) for text in ("mug", "ball") * 15]
        return await asyncio.gather(*calls)

    results = _talk(faces, talk)
    assert {tuple(_said(result)["label"] for result in results)} == {("mug", "ball") * 15}


def test_who_goes_away_ends_what_was_begun(faces: Faces, scene_id: str, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, ended = threading.Event(), threading.Event()

    def slow(*_: Any, **__: Any) -> Any:
        begun.set()
        try:
            while True:
                check_cancelled()
                time.sleep(0.01)
        finally:
            ended.set()

    monkeypatch.setattr(Answers, "query", slow)
    body = {
        **{"jsonrpc": "2.0", "id": 1, "method": "tools/call"},
        "params": {"name": "find", "arguments": {"text": "mug", "scene": scene_id}},
    }
    content = json.dumps(body).encode()
    with socket.create_connection(("127.0.0.1", faces.ports.http)) as connection:
        connection.sendall(
            b"POST /mcp HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
            b"Accept: application/json, text/event-stream\r\nContent-Length: %d\r\n\r\n" % len(content) + content
        )
        assert begun.wait(20) and not ended.is_set()
    assert ended.wait(20)


def test_a_key_is_in_no_log_and_no_answer(tmp_path: Path) -> None:
    """The server is not there: what is said of that names everything but the key."""
    secret = "fs_" + "k" * 40
    command = ["-m", "fastsplat.cli.main", "mcp", "--server", "http://127.0.0.1:9"]
    log = tmp_path / "log"

    async def talk() -> Any:
        parameters = StdioServerParameters(
            command=sys.executable, args=command, env={**os.environ, "FASTSPLAT_KEY": secret}
        )
        with log.open("w") as stream:
            async with McpClient(stdio_client(parameters, errlog=stream)) as client:
                return await client.call_tool("list_scenes", {})

    refusal = _refusal(asyncio.run(talk()))
    assert "UNREACHABLE" in refusal and secret not in refusal and secret not in log.read_text()
