"""Keys of one scene: what a link shows, and that nothing else is there for it, over both protocols."""

from __future__ import annotations

import re
import uuid
from typing import Any

import pytest
from google.protobuf import message_factory

from fastsplat.api.access.policy import rule_of
from fastsplat.api.rest.access import route_name
from fastsplat_client import Client
from fastsplat_client.keys import share_link
from fastsplat_contract.errors import (
    ConflictError,
    InvalidInputError,
    NotFoundError,
    PermissionDeniedError,
    UnauthenticatedError,
)
from fastsplat_contract.keys import KeyIn
from fastsplat_contract.scenes import Edit
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import client_of
from tests.api.made_scene import add_known_name, add_scene
from tests.api.served import Faces, rest_refusal, rpc_refusal
from tests.api.test_access_matrix import _REQUESTS, _ROUTES, _RPCS, _SERVICE, _call, _Place, place

__all__ = ["place"]

_SHOWN = {
    *("GetScene", "ListScenes", "ListLabels", "ListObjects", "ListThings", "PickThing", "ListVersions", "Query"),
    *("StreamQuery", "DownloadCameras", "RenderView", "DownloadScenePly", "DownloadMaskPly", "ExportScene"),
    *("DownloadThingIds", "ListPhotos", "DownloadPhoto", "ListBestViews", "MeasureScene", "ListNextPhotos"),
    "GetGoal",
    "ListDetections",
    "Localize",
}
"""The calls that a key of one scene may make. A new call is not among them by itself."""


@pytest.fixture(scope="module")
def link(place: _Place) -> str:
    """The caller whose key shows the scene of `place.ids(own=False)` alone; there are others beside it."""
    scene_id = place.ids(own=False)["scene_id"]
    add_scene(place.service, place.settings, "another")
    with client_of(place.faces, key=place.keys["admin"]) as admin:
        place.keys["link"] = admin.keys.share(scene_id, "for Ada", 3600.0).secret
    return "link"


def _client(place: _Place, caller: str) -> Client:
    return client_of(place.faces, key=place.keys[caller])


@pytest.mark.parametrize(("name", "method"), _RPCS, ids=lambda value: value if isinstance(value, str) else "")
def test_every_rpc_with_a_link(place: _Place, link: str, name: str, method: Any) -> None:
    ids = place.ids(own=False)
    error = _call(place, name, method, link, ids)
    if name not in _SHOWN:
        assert error is not None and rpc_refusal(error).reason == "PERMISSION_DENIED"
        return
    if name == "GetGoal":  # may be called, but the made scene's z is not up
        assert error is not None and rpc_refusal(error).details["field"] == "scene_id"
    else:
        assert error is None, error
    fields = message_factory.GetMessageClass(method.input_type).DESCRIPTOR.fields_by_name
    if name != "StreamQuery" and "scene_id" not in fields:
        return
    others = {**ids, "scene_id": add_scene(place.service, place.settings)}
    error = _call(place, name, method, link, others)
    nothing = _call(place, name, method, link, {**ids, "scene_id": uuid.uuid4().hex})
    assert error is not None and nothing is not None
    texts = [re.sub(r"[0-9a-f]{32}", "ID", rpc_refusal(each).detail) for each in (error, nothing)]
    assert rpc_refusal(error).reason == rpc_refusal(nothing).reason == "NOT_FOUND" and texts[0] == texts[1]


@pytest.mark.parametrize(("context", "method"), _ROUTES, ids=lambda value: getattr(value, "path", value))
def test_every_route_with_a_link(place: _Place, link: str, context: Any, method: str) -> None:
    name = route_name(context, method)
    rule = rule_of(name)
    if rule.role is None:
        return

    def ask(**values: str) -> Any:
        kind = "label_map" if context.path.endswith(".npy") else "rgb"
        path = context.path.format(**values, kind=kind, format="spz")
        request = _REQUESTS.get(name, {})
        headers = {**request.get("headers", {}), **place.header(link)}
        params = {"text": "mug", "view": "front.png"}
        return place.faces.rest.request(method, path, params=params, **{**request, "headers": headers})

    ids = place.ids(own=False)
    response = ask(**ids)
    if not rule.shared:
        assert response.status_code == 403, response.text
        return
    if name.endswith("/goal"):
        assert rest_refusal(response).details["field"] == "scene_id"
    else:
        assert response.status_code == 200, response.text
    if "{scene_id}" in context.path:
        other = ask(**{**ids, "scene_id": add_scene(place.service, place.settings)})
        assert rest_refusal(other).code == 404


def test_what_a_link_may_call_is_listed() -> None:
    assert {name for name, _ in _RPCS if rule_of(_SERVICE + name).shared} == _SHOWN


def test_lists_and_questions_to_all_show_the_one_scene(place: _Place, link: str) -> None:
    scene_id = place.ids(own=False)["scene_id"]
    with _client(place, link) as client:
        assert [scene.id for scene in client.scenes()] == [scene_id]
    answers = place.faces.rest.get("/query", params={"text": "mug"}, headers=place.header(link)).json()["answers"]
    assert {answer["scene_id"] for answer in answers} == {scene_id}
    metadata = tuple((name.lower(), value) for name, value in place.header(link).items())
    listed = place.faces.rpc.ListScenes(pb.ListScenesRequest(), metadata=metadata).scenes
    assert [scene.id for scene in listed] == [scene_id]


def test_names_of_other_scenes_are_not_suggested_to_a_link(place: _Place, link: str) -> None:
    store = place.service._store
    shown = store.in_project("default", place.ids(own=False)["scene_id"])
    other = add_scene(place.service, place.settings)
    add_known_name(place.service, other, "a secret")
    assert shown.only_scene and not store.only_scene
    with _client(place, link) as client:
        for thing in client.things(place.ids(own=False)["scene_id"]):
            assert not [each for each in thing.suggestions if each.scene_id]


def test_a_link_shows_nobody_s_key_name(place: _Place) -> None:
    scene_id = add_scene(place.service, place.settings)
    place.keys["Ada"] = place.service.admin.keys.create("Ada", "editor")[1]
    with _client(place, "Ada") as editor:
        editor.edit_scene(scene_id, [Edit("recolor", label="mug", color=(0.0, 0.0, 1.0))])
        assert [version.author for version in editor.versions(scene_id)] == ["", "Ada"]
    with _client(place, "admin") as admin:
        place.keys["visitor"] = admin.keys.share(scene_id, "for Eve", 3600.0).secret
    with _client(place, "visitor") as visitor:
        assert [version.author for version in visitor.versions(scene_id)] == ["", ""]
    metadata = tuple((name.lower(), value) for name, value in place.header("visitor").items())
    listed = place.faces.rpc.ListVersions(pb.ListVersionsRequest(scene_id=scene_id), metadata=metadata)
    assert [version.author for version in listed.versions] == ["", ""]


def test_links_are_listed_by_scene_and_revoked(place: _Place) -> None:
    scene_id = add_scene(place.service, place.settings)
    with _client(place, "admin") as admin:
        made = admin.keys.share(scene_id, "for a day", 86_400.0)
        assert made.key.scene_id == scene_id and made.key.role == "reader" and made.key.expires_at is not None
        assert [key.id for key in admin.keys.all(scene_id)] == [made.key.id]
        assert made.key.id in {key.id for key in admin.keys.all()}
        assert share_link("https://x/", made) == f"https://x/#/scenes/{scene_id}?share={made.secret}"
        with client_of(place.faces, key=made.secret) as visitor:
            assert visitor.scene(scene_id).id == scene_id
            with pytest.raises(PermissionDeniedError):
                list(visitor.keys.all())
        admin.keys.revoke(made.key.id)
        with client_of(place.faces, key=made.secret) as visitor, pytest.raises(UnauthenticatedError):
            _until_refused(visitor, scene_id)
        with pytest.raises(NotFoundError):
            admin.keys.share(uuid.uuid4().hex, "for nothing", 60.0)
    with _client(place, "stranger") as stranger, pytest.raises(NotFoundError):
        stranger.keys.share(scene_id, "of another project", 60.0)


def _until_refused(client: Client, scene_id: str) -> None:
    for _ in range(5_000):  # a server looks at the keys again after a second
        client.scene(scene_id)


def test_a_link_expires_and_only_looks(place: _Place) -> None:
    scene_id = place.ids(own=False)["scene_id"]
    for body in (KeyIn("for ever", "reader", None, scene_id), KeyIn("an editor", "editor", 60.0, scene_id)):
        with pytest.raises(InvalidInputError):
            place.service.keys.create("operator", body)


def test_the_links_of_a_scene_that_was_deleted_are_revoked(place: _Place) -> None:
    scene_id = add_scene(place.service, place.settings)
    made = place.service.keys.create("admin", KeyIn("link", "reader", 60.0, scene_id))
    place.service.delete_scene(scene_id)
    (key,) = place.service.keys.list("admin", scene_id=scene_id).keys
    assert (key.id, key.state) == (made.key.id, "REVOKED")


def test_where_nobody_needs_a_key_a_link_is_refused(faces: Faces, scene_id: str) -> None:
    with client_of(faces) as client, pytest.raises(ConflictError):
        client.keys.share(scene_id, "a link", 60.0)
