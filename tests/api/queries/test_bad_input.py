"""Malformed questions: the right status on both protocols, and the field to blame."""

from __future__ import annotations

import contextlib
import copy
import http.client
import json
from typing import Any

import grpc
import httpx
import pytest

from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.codec.proto_codec import to_proto
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.made_scene import turned
from tests.api.served import Faces, Refusal, rest_refusal, rpc_refusal

_CAMERA = to_plain(turned(0.1))


def _rpc(faces: Faces, request: pb.QueryRequest) -> Refusal:
    with pytest.raises(grpc.RpcError) as caught:
        list(faces.rpc.Query(request))
    return rpc_refusal(caught.value)


def _get(faces: Faces, target: str) -> httpx.Response:
    """A GET of any length; httpx itself refuses to send long ones."""
    connection = http.client.HTTPConnection("127.0.0.1", faces.ports.http, timeout=30)
    with contextlib.closing(connection):
        connection.request("GET", target)
        response = connection.getresponse()
        return httpx.Response(response.status, headers=response.getheaders(), content=response.read())


def _agree(rest: Refusal, rpc: Refusal) -> None:
    assert (rest.reason, rest.detail, rest.details) == (rpc.reason, rpc.detail, rpc.details)


def test_a_100_kb_question_passes_a_limit_that_is_named(faces: Faces, scene_id: str) -> None:
    text = "mug " * 25_000
    rpc = _rpc(faces, pb.QueryRequest(scene_id=scene_id, texts=[text]))
    posted = rest_refusal(faces.rest.post(f"/v1/scenes/{scene_id}:query", json={"texts": [text]}))
    in_url = rest_refusal(_get(faces, f"/query?scene={scene_id}&text={text.replace(' ', '+')}"))
    assert (posted.code, in_url.code, rpc.code) == (413, 413, "RESOURCE_EXHAUSTED")
    assert rpc.details["limit"] == "1000 characters"
    _agree(posted, rpc)
    _agree(in_url, rpc)


def test_a_body_beyond_any_reason_is_refused_while_it_arrives(faces: Faces, scene_id: str) -> None:
    def endless() -> Any:
        yield b'{"texts": ["'
        for _ in range(80):
            yield b"x" * 2**16
        yield b'"]}'

    headers = {"Content-Type": "application/json"}
    refused = rest_refusal(faces.rest.post(f"/v1/scenes/{scene_id}:query", content=endless(), headers=headers))
    assert refused.code == 413 and refused.details["field"] == "body"


@pytest.mark.parametrize("scene", ["nothing", "..", "a/b", "x" * 5000, "ü\0"])
def test_an_unknown_scene_is_not_found(faces: Faces, scene: str) -> None:
    rest = rest_refusal(faces.rest.get("/query", params={"text": "mug", "scene": scene}))
    rpc = _rpc(faces, pb.QueryRequest(scene_id=scene, texts=["mug"]))
    assert (rest.code, rpc.code) == (404, "NOT_FOUND")
    _agree(rest, rpc)


def _changed(path: str, value: Any) -> dict[str, Any]:
    camera = copy.deepcopy(_CAMERA)
    *groups, last = path.split(".")
    inner = camera
    for group in groups:
        inner = inner[group]
    inner[last] = value
    return camera


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
@pytest.mark.parametrize("path", ["position.x", "orientation.y", "intrinsics.fx", "intrinsics.cy"])
def test_numbers_that_are_none_are_malformed(faces: Faces, scene_id: str, path: str, number: str) -> None:
    body = json.dumps({"texts": ["mug"], "cameras": [_changed(path, "?")], "outputs": ["mask2d"]})
    headers = {"Content-Type": "application/json"}
    content = body.replace('"?"', number)
    rest = rest_refusal(faces.rest.post(f"/v1/scenes/{scene_id}:query", content=content, headers=headers))
    message = to_proto(turned(0.1))
    group, name = path.split(".")
    setattr(getattr(message, group), name, float(number))
    rpc = _rpc(faces, pb.QueryRequest(scene_id=scene_id, texts=["mug"], cameras=[message], outputs=[pb.OUTPUT_MASK2D]))
    assert (rest.code, rpc.code) == (400, "INVALID_ARGUMENT")
    assert rest.details["field"] == f"cameras[0].{path}"


_BAD_BODIES = {
    "no json": ("{", "body"),
    "no object": ("[]", "body"),
    "unknown field": ('{"texts": ["mug"], "text": "mug"}', "text"),
    "wrong type": ('{"texts": "mug"}', "texts"),
    "number for text": ('{"texts": [7]}', "texts[0]"),
    "unknown output": ('{"texts": ["mug"], "outputs": ["mask4d"]}', "outputs[0]"),
    "half a pose": ('{"texts": ["mug"], "cameras": [{"position": {"x": 0, "y": 0}}]}', "cameras[0].intrinsics"),
    "number as string": (
        json.dumps({"texts": ["mug"], "cameras": [_changed("position.x", "1")]}),
        "cameras[0].position.x",
    ),
    "frame of surrogates": (json.dumps({"texts": ["mug"], "cameras": [_changed("frame_id", "\ud800")]}), None),
}


@pytest.mark.parametrize("case", _BAD_BODIES)
def test_json_is_read_strictly_and_the_field_is_named(faces: Faces, scene_id: str, case: str) -> None:
    content, field = _BAD_BODIES[case]
    headers = {"Content-Type": "application/json"}
    refused = rest_refusal(faces.rest.post(f"/v1/scenes/{scene_id}:query", content=content, headers=headers))
    assert refused.code == 400
    assert field is None or refused.details["field"] == field


def test_messages_that_say_half_are_malformed(faces: Faces, scene_id: str) -> None:
    bare = pb.PosedCamera(intrinsics=to_proto(turned(0)).intrinsics)
    odd = to_proto(turned(0))
    odd.convention = 17
    cases = (
        (pb.QueryRequest(scene_id=scene_id, texts=["mug"], cameras=[bare]), "cameras[0].position"),
        (pb.QueryRequest(scene_id=scene_id, texts=["mug"], cameras=[odd]), "cameras[0].convention"),
        (pb.QueryRequest(scene_id=scene_id, texts=["mug"], outputs=[pb.OUTPUT_UNSPECIFIED]), "outputs"),
        (pb.QueryRequest(texts=["mug"], views=["front.png"]), "scene_id"),
        (pb.QueryRequest(scene_id=scene_id, texts=["mug"], version="a\0b"), "version"),
    )
    for request, field in cases:
        refused = _rpc(faces, request)
        assert refused.code == "INVALID_ARGUMENT" and refused.details["field"] == field
    for request in (
        pb.RenderViewRequest(scene_id=scene_id, view="front.png"),
        pb.RenderViewRequest(scene_id=scene_id, kind=pb.PICTURE_KIND_RGB),
        pb.RenderViewRequest(scene_id=scene_id, kind=pb.PICTURE_KIND_MASK, view="front.png"),
    ):
        with pytest.raises(grpc.RpcError) as caught:
            list(faces.rpc.RenderView(request))
        assert rpc_refusal(caught.value).code == "INVALID_ARGUMENT"


def test_query_parameters_are_checked(faces: Faces, scene_id: str) -> None:
    cases = {
        "/v1/scenes?page_size=x": "page_size",
        "/v1/scenes?page_size=-1": "page_size",
        "/v1/scenes?page_token=x": "page_token",
        f"/v1/scenes/{scene_id}/rainbow.png?view=front.png": "kind",
        f"/v1/scenes/{scene_id}/mask.png?view=front.png": "text",
        f"/v1/scenes/{scene_id}/rgb.png": "view",
        f"/v1/scenes/{scene_id}/mask3d.bin": "text",
        "/v1/operations/none:wait?timeout_s=1e9": "timeout_s",
    }
    for path, field in cases.items():
        refused = rest_refusal(faces.rest.get(path))
        assert refused.code == 400 and refused.details["field"] == field, path


_HALF = '"\\ud800"'


@pytest.mark.parametrize(
    ("call", "body", "field"),
    [
        (":query", '{"texts": ["mug"], "version": HALF}', "version"),
        (":query", '{"texts": ["mug", HALF]}', "text"),
        (":query", '{"texts": ["mug"], "views": [HALF], "outputs": ["mask2d"]}', "views[0]"),
        (":render", '{"kind": "rgb", "view": "front.png", "version": HALF}', "version"),
        (":render", '{"kind": "mask", "view": "front.png", "text": HALF}', "text"),
        (":edit", '{"edits": [{"action": "remove", "label": HALF}]}', "edits[0].label"),
        (":undo", '{"version": HALF}', ""),
    ],
)
@pytest.mark.parametrize("text", [_HALF, '"\\u0000"'], ids=["half a surrogate pair", "NUL"])
def test_a_text_that_is_none_is_refused_by_its_field(
    faces: Faces, scene_id: str, call: str, body: str, field: str, text: str
) -> None:
    headers = {"content-type": "application/json"}
    url = f"/v1/scenes/{scene_id}{call}"
    refusal = rest_refusal(faces.rest.post(url, content=body.replace("HALF", text), headers=headers))
    assert refusal.code in (400, 404, 409)
    if field:
        assert (refusal.reason, refusal.details["field"]) == ("INVALID_INPUT", field)
