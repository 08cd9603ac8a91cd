"""`fastsplat mcp --data sample`: the official client starts the real command; the truth is how the sample was made."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import Callable, Coroutine, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcp import Client as McpClient
from mcp import StdioServerParameters, stdio_client
from mcp_types import CallToolResult

Talk = Callable[[McpClient], Coroutine[Any, Any, Any]]

_MIDDLES = {  # meters from the middle of the table, x and y, as `demo/sample_layout.py` places them
    "banana": (0.15, -0.2),
    "bottle": (0.19, 0.27),
    "clock": (-0.35, 0.06),
    "cup": (-0.1, -0.02),
    "teddy bear": (-0.005, 0.25),
}


def _session(talk: Talk, models: Path, temporary: Path) -> Any:
    """Returns what `talk` returns of a session without network, started in an empty folder without settings."""
    home, empty = temporary.with_name(f"{temporary.name}-home"), temporary.with_name(f"{temporary.name}-empty")
    (home / "fastsplat").mkdir(parents=True)
    (home / "fastsplat" / "models").symlink_to(models.resolve())
    empty.mkdir()
    environment = {**os.environ, "XDG_DATA_HOME": str(home), "TMPDIR": str(temporary)}
    for name in ("FASTSPLAT_SERVER", "FASTSPLAT_KEY", "FASTSPLAT_DATA_DIR", "FASTSPLAT_MODELS"):
        environment.pop(name, None)
    command = StdioServerParameters(
        command=sys.executable, args=["-m", "fastsplat.cli.main", "mcp", "--data", "sample"], env=environment, cwd=empty
    )

    async def session() -> Any:
        async with McpClient(stdio_client(command)) as client:
            return await talk(client)

    return asyncio.run(session())


def _said(result: CallToolResult) -> Any:
    assert not result.is_error, result.content
    assert result.structured_content is not None
    return result.structured_content


@pytest.fixture(scope="module")
def answers(models_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """What each tool says, in one session."""
    temporary = tmp_path_factory.mktemp("temporary")

    async def talk(client: McpClient) -> dict[str, Any]:
        async def call(tool: str, **arguments: Any) -> Any:
            return _said(await client.call_tool(tool, arguments))

        said: dict[str, Any] = {"tools": {tool.name for tool in (await client.list_tools()).tools}}
        for tool in ("list_scenes", "describe_scene", "list_objects", "photograph_next", "scene_status"):
            said[tool] = await call(tool)
        for name in (*_MIDDLES, "submarine"):
            said[f"find {name}"] = await call("find", text=name)
        said["find apples"] = await call("find", text="apples")
        said["on the table"] = await call("relations", text="what is on the table?")
        found = said["find banana"]
        ids = [said[f"find {name}"]["places"][0]["id"] for name in ("cup", "bottle")]
        said["measure"] = await call("measure", first=ids[0], second=ids[1])
        said["look_from"] = await client.call_tool("look_from", {"object_id": found["objects"][0]["id"]})
        said["name_object"] = await call("name_object", object_id=found["objects"][0]["id"], name="breakfast")
        said["find renamed"] = await call("find", text="breakfast")
        return said

    yield _session(talk, models_dir, temporary)
    assert list(temporary.glob("fastsplat*")) == []  # the edits went with the session


def test_there_is_one_scene_in_meters(answers: dict[str, Any]) -> None:
    (scene,) = answers["list_scenes"]["scenes"]
    assert (scene["name"], scene["state"], scene["unit"], answers["list_scenes"]["more"]) == ("sample", "READY", "m", 0)
    described = answers["describe_scene"]
    assert described["photos"] == 26 and described["grade"] == "good" and described["more_names"] == 0
    assert {"apple", "banana", "cup", "vase"} <= described["names"].keys()
    assert answers["scene_status"]["job"] == "SUCCEEDED"
    assert len(answers["list_objects"]["objects"]) >= 15


@pytest.mark.parametrize("name", _MIDDLES)
def test_objects_are_where_they_were_put(answers: dict[str, Any], name: str) -> None:
    where = answers[f"find {name}"]
    assert where["outcome"] == "here" and where["unit"] == "m"
    assert np.allclose(
        where["places"][0]["center"][:2], _MIDDLES[name], atol=0.06
    )  # backs that no photo shows are not there


def test_a_name_that_is_given_is_found_in_that_session(answers: dict[str, Any]) -> None:
    assert answers["find renamed"]["outcome"] == "here"
    assert answers["find renamed"]["objects"][0]["id"] == answers["name_object"]["object_id"]


def test_without_models_what_is_missing_is_said(tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    (tmp_path / "temporary").mkdir()

    async def talk(client: McpClient) -> Any:
        return await client.call_tool("list_scenes", {}), await client.call_tool("find", {"text": "cup"})

    listed, found = _session(talk, tmp_path / "models", tmp_path / "temporary")
    assert len(_said(listed)["scenes"]) == 1
    assert found.is_error and "MODEL_UNAVAILABLE" in found.content[0].text
    assert "fastsplat models pull" in found.content[0].text


def test_the_sample_takes_nothing_of_a_server() -> None:
    command = [sys.executable, "-m", "fastsplat.cli.main", "mcp", "--data", "sample", "--server", "http://127.0.0.1:9"]
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    assert done.returncode == 2 and "INVALID_INPUT" in done.stderr and "both a server" in done.stderr
