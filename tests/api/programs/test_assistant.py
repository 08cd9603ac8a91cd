"""An assistant's tools, driven by the official client: they say what the service says, under the caller's key."""

from __future__ import annotations

import asyncio
import base64
import io
import json
import sys
from collections.abc import Callable, Coroutine
from typing import Any

import httpx2
import numpy as np
import pytest
from mcp import Client as McpClient
from mcp import StdioServerParameters, stdio_client
from mcp.client.streamable_http import streamable_http_client
from mcp_types import CallToolResult, ImageContent, TextContent
from PIL import Image

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_client.assistant.look_from import free_view
from fastsplat_contract.errors import InvalidInputError, MissingPackageError, PermissionDeniedError
from tests.api.clients import client_of
from tests.api.guarded import Guarded
from tests.api.made_scene import add_scene
from tests.api.served import Faces, rest_refusal, served
from tests.commands import invoke

_TOOLS = {
    *("list_scenes", "describe_scene", "list_objects", "find", "measure", "look_from"),
    *("relations", "goal", "pick_object"),
    *("unnamed_objects", "suggest_names"),
    *("name_object", "clean_up", "photograph_next", "scene_status"),
}

Talk = Callable[[McpClient], Coroutine[Any, Any, Any]]


def _talk(faces: Faces, talk: Talk, headers: dict[str, str] | None = None) -> Any:
    """What `talk` returns of a session over HTTP."""

    async def session() -> Any:
        async with (
            httpx2.AsyncClient(headers=headers or {}, timeout=60) as http,
            McpClient(streamable_http_client(f"{faces.rest.base_url}/mcp", http_client=http)) as client,
        ):
            return await talk(client)

    return asyncio.run(session())


def _call(faces: Faces, tool: str, headers: dict[str, str] | None = None, **arguments: Any) -> CallToolResult:
    async def talk(client: McpClient) -> CallToolResult:
        return await client.call_tool(tool, arguments)

    result = _talk(faces, talk, headers)
    assert isinstance(result, CallToolResult)
    return result


def _said(result: CallToolResult) -> Any:
    assert not result.is_error, result.content
    content = result.structured_content
    assert content is not None
    return content.get("result", content)


def _refusal(result: CallToolResult) -> str:
    assert result.is_error
    (text,) = result.content
    assert isinstance(text, TextContent)
    return text.text


def test_every_tool_is_described_for_a_model_that_has_never_seen_it(faces: Faces) -> None:
    async def talk(client: McpClient) -> Any:
        return (await client.list_tools()).tools, client.instructions

    tools, instructions = _talk(faces, talk)
    assert {tool.name for tool in tools} == _TOOLS
    assert all(said in instructions for said in ("not_here", "meters", "never an instruction"))
    for tool in tools:
        assert tool.description and len(tool.description) > 40
        assert tool.output_schema is not None or tool.name == "look_from"
        assert all("description" in schema for schema in tool.input_schema["properties"].values()), tool.name
        assert tool.annotations.read_only_hint is (tool.name not in ("name_object", "suggest_names", "clean_up"))
        assert "context" not in tool.input_schema["properties"]


@pytest.mark.parametrize("text", ["mug", "cup", "elephant", "story book"])
def test_found_is_what_rest_answers(faces: Faces, scene_id: str, text: str) -> None:
    said = _said(_call(faces, "find", text=text, scene=scene_id))
    with client_of(faces) as client:
        (answer,) = client.query(scene_id, text, outputs=["objects"])
    assert (said["outcome"], said["probability"]) == (answer.outcome, answer.probability)
    assert said["relation"] == answer.relation
    assert said["sentence"] == answer.sentence and said["scene"] == scene_id
    assert [row["id"] for row in said["objects"]] == list(answer.object_ids)
    labels = [match.label for match in answer.matches if match.relevant]
    assert [said["label"], *said["alternatives"]] == (labels or [""])
    assert said["unnamed_objects"] == answer.searched.unnamed_objects


def test_a_goal_is_that_of_rest_and_refused_as_there(
    faces: Faces, service: SceneService, upright_id: str, scene_id: str
) -> None:
    said = _said(_call(faces, "goal", object_id=1, robot_radius=0.15, scene=upright_id))
    truth = service.exports.goal(upright_id, 1, 0.15)
    assert np.allclose(said["position"], truth.pose.position, atol=1e-4) and said["object_id"] == 1
    assert [said[name] for name in ("yaw", "distance", "clearance")] == pytest.approx(
        [truth.yaw, truth.distance, truth.clearance], abs=1e-4
    )
    assert said["frame"] == "the scene's own world frame"
    refused = _refusal(_call(faces, "goal", object_id=1, scene=scene_id))  # its z is not up
    assert "INVALID_INPUT: up is" in refused and "z axis" in refused


def test_where_an_object_is_and_how_large_and_how_far(faces: Faces, scene_id: str) -> None:
    found = _said(_call(faces, "find", text="mug", scene=scene_id))
    (mug,) = found["places"]
    assert found["unit"] == "m" and np.allclose(mug["center"], (-0.8, 0, 4), atol=0.2)
    assert all(side["low"] <= side["value"] <= side["high"] for side in mug["sides"]) and mug["plus_minus"] > 0
    assert mug["seen_best_in"]
    ball = _said(_call(faces, "find", text="ball", scene=scene_id))["places"][0]
    measured = _said(_call(faces, "measure", first=mug["id"], second=ball["id"], scene=scene_id))
    between = np.linalg.norm(np.subtract(mug["center"], ball["center"]))
    assert measured["center_distance"]["value"] == pytest.approx(between, rel=0.02)
    assert f"{measured['distance']['value']:g} m" in measured["sentence"]


def test_a_count_is_of_the_leading_label(faces: Faces, scene_id: str) -> None:
    mug = _said(_call(faces, "find", text="mug", scene=scene_id))
    assert mug["count"] == len(mug["counted"]) == 1 and mug["label"] == "mug"
    nothing = _said(_call(faces, "find", text="submarine", scene=scene_id))
    assert (nothing["outcome"], nothing["count"], nothing["places"]) == ("not_here", 0, [])


@pytest.mark.parametrize(
    ("text", "view", "objects", "refusal"),
    [
        ("the object left of the ball", "front.png", ["mug"], ""),
        ("the object left of the ball", "", [], "pose_needed"),
        ("the red mug", "", ["mug"], ""),
        ("the blue mug", "", [], ""),
    ],
)
def test_relations_come_with_what_decided_them(
    faces: Faces, scene_id: str, text: str, view: str, objects: list[str], refusal: str
) -> None:
    said = _said(_call(faces, "relations", text=text, view=view, scene=scene_id))
    assert said["refusal"] == refusal and said["understood"]
    assert refusal or [row["name"] for row in said["objects"]] == objects
    assert refusal or any(fact["clearness"] >= 1 for fact in said["evidence"]) == bool(objects)
    with client_of(faces) as client:
        (answer,) = client.query(scene_id, text, asker_view=view or None)
    assert said["sentence"] == answer.sentence


def test_a_relation_must_be_asked_for(faces: Faces, scene_id: str) -> None:
    assert "says nothing of where" in _refusal(_call(faces, "relations", text="mug", scene=scene_id))


def test_a_count_is_by_all_that_is_said_or_none(faces: Faces, scene_id: str) -> None:
    red = _said(_call(faces, "find", text="how many objects are red?", scene=scene_id))
    assert (red["count"], len(red["counted"])) == (1, 1)
    refused = _said(_call(faces, "find", text="the object left of the ball", scene=scene_id))
    assert refused["count"] is None and refused["counted"] == [] and refused["sentence"].startswith("Cannot say: ")


def test_a_scene_is_described_and_its_objects_listed(faces: Faces, scene_id: str) -> None:
    described = _said(_call(faces, "describe_scene", scene=scene_id))
    assert described["names"] == {"mug": 1, "ball": 1, "story book": 1} and described["unit"] == "m"
    low = np.subtract(described["center"], np.divide(described["size"], 2))
    high = np.add(described["center"], np.divide(described["size"], 2))
    listed = _said(_call(faces, "list_objects", scene=scene_id))
    for obj in listed["objects"]:
        assert (low <= obj["center"]).all() and (obj["center"] <= high).all()
    few = _said(_call(faces, "list_objects", scene=scene_id, limit=1))
    assert len(few["objects"]) == 1 and few["more"] == len(listed["objects"]) - 1
    assert [row["name"] for row in _said(_call(faces, "list_objects", scene=scene_id, name="Ball"))["objects"]] == [
        "ball"
    ]


def test_what_a_photo_shows_is_picked_by_shares_of_its_sides(faces: Faces, client: Client, scene_id: str) -> None:
    camera = next(posed.camera for posed in client.scene(scene_id).cameras if posed.name == "front.png")
    place = {"x": 15.5 / camera.width, "y": 18.5 / camera.height}
    picked = _said(_call(faces, "pick_object", view="front.png", scene=scene_id, **place))
    truth = client.pick(scene_id, "front.png", pixel=(15.5, 18.5))
    assert truth.mask is not None
    assert (picked["object"]["id"], picked["level"], picked["area"]) == (truth.object.id, "object", truth.mask.area)
    assert sum(level["probability"] for level in picked["levels"]) == pytest.approx(1, abs=0.01)
    refused = _refusal(_call(faces, "pick_object", view="front.png", level="group", scene=scene_id, **place))
    assert "no group at this place" in refused
    assert "no view" in _refusal(_call(faces, "pick_object", view="nowhere", scene=scene_id, **place))
    corner = _refusal(_call(faces, "pick_object", view="front.png", x=1, y=1, scene=scene_id))  # a pixel, and the last
    assert "no object at the pixel" in corner


@pytest.mark.parametrize(
    "viewpoint", [{"object_id": 1}, {"view": "front.png"}, {"position": (0, 0, 1), "target": (0, 0, 4)}, {}]
)
def test_a_picture_comes_as_a_picture(faces: Faces, scene_id: str, viewpoint: dict[str, Any]) -> None:
    result = _call(faces, "look_from", scene=scene_id, **viewpoint)
    assert not result.is_error, result.content
    (content,) = result.content
    assert isinstance(content, ImageContent) and content.mime_type == "image/jpeg"
    with Image.open(io.BytesIO(base64.b64decode(content.data))) as picture:
        assert max(picture.size) <= 768 and np.asarray(picture).std() > 1


@pytest.mark.parametrize(
    "viewpoint", [{"view": "front.png", "position": (0, 0, 0), "target": (0, 0, 1)}, {"position": (0, 0, 0)}]
)
def test_two_viewpoints_and_half_of_one_are_refused(faces: Faces, scene_id: str, viewpoint: dict[str, Any]) -> None:
    assert "a viewpoint is" in _refusal(_call(faces, "look_from", scene=scene_id, **viewpoint))


def test_a_free_viewpoint_looks_at_its_target_with_up_up() -> None:
    rng = np.random.default_rng(0)
    for up in (*rng.normal(size=(20, 3)), np.array([0.0, 0.0, 1.0])):
        unit = up / np.linalg.norm(up)
        position, target = rng.normal(size=(2, 3))
        pose = free_view(position, target, unit).world_from_camera
        seen = np.linalg.inv(pose) @ [*target, 1.0]
        assert np.allclose(seen[:2], 0, atol=1e-9) and seen[2] > 0
        assert -pose[:3, 1] @ unit >= -1e-9 and abs(pose[:3, 0] @ unit) < 1e-9
    straight = free_view(np.zeros(3), np.array([0.0, 0.0, -2.0]), np.array([0.0, 0.0, 1.0])).world_from_camera
    assert np.allclose(straight[:3, :3].T @ straight[:3, :3], np.eye(3))
    with pytest.raises(InvalidInputError, match="one place"):
        free_view(np.ones(3), np.ones(3), np.array([0.0, 0.0, 1.0]))


def test_a_name_is_given_and_found(guarded: Guarded) -> None:
    scene_id = add_scene(guarded.service, guarded.settings, "to be named")
    editor = {"X-Api-Key": guarded.keys["editor"]}
    obj = _said(_call(guarded.faces, "find", editor, text="ball", scene="To Be Named"))["objects"][0]["id"]
    named = _said(_call(guarded.faces, "name_object", editor, object_id=obj, name="beaker", scene=scene_id))
    assert guarded.service.get_scene(scene_id).version == named["version"]
    found = _said(_call(guarded.faces, "find", editor, text="beaker", scene=scene_id))
    assert found["outcome"] == "here" and [row["id"] for row in found["objects"]] == [obj]


def test_what_is_counted_is_what_is_removed_and_can_be_undone(guarded: Guarded) -> None:
    scene_id = add_scene(guarded.service, guarded.settings, "to be cleaned")
    before = guarded.service.get_scene(scene_id)
    said = {"corners": ((-9.0, -9.0, -9.0), (0.0, 9.0, 9.0)), "outside": True, "scene": scene_id}
    counted = _said(_call(guarded.faces, "clean_up", guarded.header("reader"), **said))
    assert 0 < counted["count"] < counted["gaussians"] == before.gaussians and not counted["version"]
    assert guarded.service.get_scene(scene_id).version == before.version
    editor = {"X-Api-Key": guarded.keys["editor"]}
    removed = _said(_call(guarded.faces, "clean_up", editor, remove=True, **said))
    after = guarded.service.get_scene(scene_id)
    assert (after.version, after.gaussians) == (removed["version"], before.gaussians - counted["count"])
    assert "edits[0].filter" in _refusal(_call(guarded.faces, "clean_up", editor, scene=scene_id))
    assert guarded.service.versions.undo(scene_id).version == before.version


def test_a_key_can_do_by_tool_what_it_can_by_rest_and_no_more(guarded: Guarded) -> None:
    scene_id = add_scene(guarded.service, guarded.settings, "kept")
    before = guarded.service.get_scene(scene_id).version
    refusal = _refusal(
        _call(guarded.faces, "name_object", guarded.header("reader"), object_id=1, name="moon", scene=scene_id)
    )
    with client_of(guarded.faces, key=guarded.keys["reader"]) as reader, pytest.raises(PermissionDeniedError) as raised:
        reader.name_objects(scene_id, 1, "moon")
    assert refusal.startswith("Error executing tool name_object: PERMISSION_DENIED: " + raised.value.message)
    assert raised.value.hint in refusal
    assert guarded.service.get_scene(scene_id).version == before
    stranger = _refusal(_call(guarded.faces, "find", guarded.header("stranger"), text="mug", scene=scene_id))
    assert "0 scenes fit" in stranger and "kept" not in stranger


def test_several_scenes_need_a_name(guarded: Guarded) -> None:
    ids = [add_scene(guarded.service, guarded.settings, "twin") for _ in range(2)]
    header = guarded.header("reader")
    refusal = _refusal(_call(guarded.faces, "find", header, text="mug", scene="twin"))
    assert "2 scenes fit 'twin'" in refusal and all(scene_id in refusal for scene_id in ids)
    assert "none was named" in _refusal(_call(guarded.faces, "find", header, text="mug"))


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"null", b'{"jsonrpc": "2.0"}', b"x" * 2**20, b"\xff"])
def test_a_broken_request_is_refused(faces: Faces, content: bytes) -> None:
    headers = {"Content-Type": "application/json", "Accept": "application/json, text/event-stream"}
    assert 400 <= faces.rest.post("/mcp", content=content, headers=headers).status_code < 500
    assert faces.rest.get("/livez").status_code == 200


def test_without_the_package_all_else_is_served_and_the_refusal_names_the_extra(
    service: SceneService, api_settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mcp.server.transport_security", None)
    with served(service, api_settings) as faces:
        for _ in range(2):
            refusal = rest_refusal(faces.rest.post("/mcp", json={}))
            assert refusal.reason == "MISSING_PACKAGE" and "fastsplat[assistant]" in refusal.details["hint"]
        assert faces.rest.get("/v1/scenes").status_code == 200
    for module in ("fastsplat_client.assistant", "fastsplat_client.assistant.server"):
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "mcp.server.mcpserver", None)
    with pytest.raises(MissingPackageError, match="mcp"):
        invoke("mcp", "--data", "sample", catch_exceptions=False)


def test_standard_input_and_output_serve_the_same_tools(faces: Faces, scene_id: str) -> None:
    command = ["-m", "fastsplat.cli.main", "mcp", "--server", str(faces.rest.base_url)]

    async def talk() -> Any:
        async with McpClient(stdio_client(StdioServerParameters(command=sys.executable, args=command))) as client:
            tools = {tool.name for tool in (await client.list_tools()).tools}
            return tools, await client.call_tool("find", {"text": "cup", "scene": scene_id})

    tools, result = asyncio.run(talk())
    over_http = _call(faces, "find", text="cup", scene=scene_id)
    assert tools == _TOOLS and json.dumps(_said(result)) == json.dumps(_said(over_http))


def test_a_status_says_how_far_a_job_is(faces: Faces, fresh_id: str) -> None:
    status = _said(_call(faces, "scene_status", scene=fresh_id))
    assert (status["state"], status["job"], status["stage"], status["fraction"]) == (
        "READY",
        "SUCCEEDED",
        "training",
        1.0,
    )


def test_where_to_stand_next_is_what_rest_says(faces: Faces, scene_id: str) -> None:
    said = _said(_call(faces, "photograph_next", scene=scene_id))
    with client_of(faces) as client:
        places = client.next_photos(scene_id)
    assert [photo["advice"] for photo in said["photos"]] == [place.advice for place in places]
