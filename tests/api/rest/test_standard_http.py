"""HTTP as people expect it: HEAD, ETag, gzip, CORS, operation ids that people can read."""

from __future__ import annotations

import gzip
import json
import re
from pathlib import Path

import pytest

from fastsplat.api.rest import access
from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from tests.api.served import Faces, rest_refusal, served

_OPENAPI = Path(__file__).parents[3] / "api/rest/openapi.json"


@pytest.mark.parametrize("path", ["", "/labels", "/scene.ply", "/rgb.png?view=front.png", "/none.png?view=front.png"])
def test_head_says_what_get_says_without_the_body(faces: Faces, scene_id: str, path: str) -> None:
    url = f"/v1/scenes/{scene_id}{path}"
    got, head = faces.rest.get(url), faces.rest.head(url)
    assert head.status_code == got.status_code and head.content == b"" and got.content
    varying = {"date", "x-request-id", "content-length"}
    assert {k: v for k, v in head.headers.items() if k not in varying} == {
        k: v for k, v in got.headers.items() if k not in varying
    }


def test_head_of_an_event_stream_ends(faces: Faces, service: SceneService, scene_id: str) -> None:
    operation_id = service.get_scene(scene_id).operation_id
    assert faces.rest.head(f"/v1/operations/{operation_id}/events").headers["content-type"].startswith("text/event")


@pytest.mark.parametrize(
    "path",
    [
        *("rgb.png?view=front.png", "mask.png?view=front.png&text=mug", "depth.npy?view=front.png"),
        *("mask3d.bin?text=mug", "mask3d.bin?text=mug&encoding=runs"),
    ],
)
def test_a_picture_or_mask_that_a_client_has_is_not_made_again(
    faces: Faces, service: SceneService, scene_id: str, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = f"/v1/scenes/{scene_id}/{path}"
    first = faces.rest.get(url)
    tag = first.headers["etag"]
    assert first.status_code == 200 and "no-cache" in first.headers["cache-control"]
    second = faces.rest.get(url.replace("front.png", "a/b/right.png").replace("mug", "ball"))
    assert second.headers["etag"] != tag and second.content != first.content
    monkeypatch.setattr(service.answers, "picture", lambda request: pytest.fail("made again"))
    for tags in (tag, f'"x", W/{tag}', "*"):
        again = faces.rest.get(url, headers={"If-None-Match": tags})
        assert again.status_code == 304 and again.content == b"" and again.headers["etag"] == tag
    gone = faces.rest.get(url.replace(scene_id, "none"), headers={"If-None-Match": "*"})
    assert rest_refusal(gone).reason == "NOT_FOUND"


@pytest.mark.parametrize("path", ["/", "/web/icon.svg", "/docs-files/swagger-ui.css"])
def test_files_of_the_page_are_compressed_for_those_who_read_it(faces: Faces, path: str) -> None:
    plain = faces.rest.get(path, headers={"Accept-Encoding": "identity"})
    assert "content-encoding" not in plain.headers and plain.headers["vary"] == "Accept-Encoding"
    with faces.rest.stream("GET", path, headers={"Accept-Encoding": "gzip"}) as response:
        raw = b"".join(response.iter_raw())
    assert response.headers["content-encoding"] == "gzip" and len(raw) < len(plain.content)
    assert gzip.decompress(raw) == plain.content and response.headers["etag"].startswith("W/")
    for name in ("etag", "content-type", "cache-control", "content-security-policy"):
        assert response.headers.get(name) == plain.headers.get(name)
    again = faces.rest.get(path, headers={"If-None-Match": response.headers["etag"], "Accept-Encoding": "gzip"})
    assert again.status_code == 304 and again.content == b""


@pytest.mark.parametrize("path", [f"/query?{'&'.join(['text=mug', 'text=novel'] * 8)}", "/openapi.json"])
@pytest.mark.parametrize(
    ("accepted", "compressed"),
    [("gzip", True), ("br, GZip;q=0.5", True), ("gzip;q=0", False), ("br, gzip; q=0.0, *", False), ("br", False)],
)
def test_large_answers_are_compressed_for_those_who_accept_it(
    faces: Faces, scene_id: str, path: str, accepted: str, compressed: bool
) -> None:
    plain = faces.rest.get(path, headers={"Accept-Encoding": "identity"})
    assert "content-encoding" not in plain.headers
    with faces.rest.stream("GET", path, headers={"Accept-Encoding": accepted}) as response:
        raw = b"".join(response.iter_raw())
    assert (response.headers.get("content-encoding") == "gzip") is compressed
    assert "Accept-Encoding" in response.headers["vary"]
    assert (gzip.decompress(raw) if compressed else raw) == plain.content


@pytest.mark.parametrize("path", ["/", "/web/icon.svg", "/docs-files/swagger-ui.css", "/openapi.json"])
def test_a_browser_asks_whether_its_copy_of_the_page_holds(faces: Faces, path: str) -> None:
    first = faces.rest.get(path)
    assert first.status_code == 200 and first.headers["cache-control"] == "no-cache"
    again = faces.rest.get(path, headers={"If-None-Match": first.headers["etag"]})
    assert again.status_code == 304 and again.content == b"" and again.headers["etag"] == first.headers["etag"]


@pytest.mark.parametrize(
    ("path", "allowed"),
    [
        ("/v1/scenes", "GET, HEAD, POST"),
        ("/v1/scenes/x", "GET, HEAD, PATCH, DELETE"),
        ("/v1/keys", "GET, HEAD, POST"),
        ("/v1/uploads", "POST, OPTIONS"),
        ("/v1/uploads/x", "HEAD, PATCH, DELETE"),
    ],
)
def test_allow_names_every_method_that_is_possible(faces: Faces, path: str, allowed: str) -> None:
    refused = faces.rest.put(path)
    assert refused.status_code == 405 and refused.headers["allow"] == allowed


def test_other_origins_may_call_only_by_setting(service: SceneService, api_settings: Settings, faces: Faces) -> None:
    headers = {"Origin": "http://localhost:3000", "Access-Control-Request-Method": "POST"}
    assert "access-control-allow-origin" not in faces.rest.options("/v1/scenes", headers=headers).headers
    settings = api_settings.model_copy(update={"cors_origins": ("http://localhost:3000",)})
    with served(service, settings) as open_faces:
        preflight = open_faces.rest.options("/v1/scenes", headers=headers)
        assert preflight.status_code == 200
        assert preflight.headers["access-control-allow-origin"] == "http://localhost:3000"
        answer = open_faces.rest.get("/v1/scenes", headers={"Origin": "http://localhost:3000"})
        assert answer.headers["access-control-allow-origin"] == "http://localhost:3000"
        foreign = open_faces.rest.options("/v1/scenes", headers={**headers, "Origin": "http://localhost:4000"})
        assert "access-control-allow-origin" not in foreign.headers


def test_operation_ids_are_names() -> None:
    paths = json.loads(_OPENAPI.read_text())["paths"]
    ids = [operation["operationId"] for methods in paths.values() for operation in methods.values()]
    assert len(ids) == len(set(ids)) and all(re.fullmatch(r"[a-z][a-z0-9_]{2,30}", name) for name in ids)


def test_a_call_that_goes_with_the_next_release_says_so(
    faces: Faces, scene_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(access, "DEPRECATED", {"GET /v1/scenes/{scene_id}/objects": "ListLabels"})
    assert faces.rest.get(f"/v1/scenes/{scene_id}/objects").headers["deprecation"].startswith("@")
    assert "deprecation" not in faces.rest.get(f"/v1/scenes/{scene_id}").headers
