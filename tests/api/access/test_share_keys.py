"""Keys of one scene: what a link shows, and that nothing else is there for it, over both protocols."""

from __future__ import annotations

import uuid

import pytest

from fastsplat.api.access.policy import rule_of
from fastsplat_client import Client
from fastsplat_client.keys import share_link
from fastsplat_contract.errors import (
    ConflictError,
    InvalidInputError,
    NotFoundError,
    PermissionDeniedError,
    UnauthenticatedError,
)
from fastsplat_contract.messages.scenes import Edit
from fastsplat_contract.server.keys import KeyIn
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import client_of
from tests.api.guarded import ROUTES, RPCS, SERVICE, Guarded, about_one, without_ids
from tests.api.made_scene import add_known_name, add_scene
from tests.api.served import Faces, rest_refusal, rpc_refusal

_LINK_CALLS = {  # calls that a key of one scene may make; a new call is not among them by itself
    *("GetScene", "ListScenes", "ListLabels", "ListObjects", "PickObject", "ListVersions", "Query"),
    *("StreamQuery", "RenderView", "ExportScene"),
    *("ListPhotos", "DownloadPhoto", "ListBestViews", "MeasureScene", "ListNextPhotos"),
    "GetGoal",
    "ListDetections",
    "GetContactSheet",
    *("Localize", "ListObservations", "GetObservation"),
}


@pytest.fixture(scope="module")
def link(guarded: Guarded) -> str:
    """The caller whose key shows the scene of `guarded.shared` alone."""
    with client_of(guarded.faces, key=guarded.keys["admin"]) as admin:
        guarded.keys["link"] = admin.keys.share(guarded.shared["scene_id"], "for Ada", 3600.0).secret
    return "link"


@pytest.fixture(scope="module")
def other_id(guarded: Guarded) -> str:
    """Another scene of the same project."""
    return add_scene(guarded.service, guarded.settings, "another")


def _client(guarded: Guarded, caller: str) -> Client:
    return client_of(guarded.faces, key=guarded.keys[caller])


@pytest.mark.parametrize("name", RPCS)
def test_every_rpc_with_a_link(guarded: Guarded, link: str, other_id: str, name: str) -> None:
    ids = guarded.shared
    error = guarded.call(name, link, ids)
    if name not in _LINK_CALLS:
        assert error is not None and rpc_refusal(error).reason == "PERMISSION_DENIED"
        return
    if name == "GetGoal":  # may be called, but the made scene's z is not up
        assert error is not None and rpc_refusal(error).details["field"] == "scene_id"
    else:
        assert error is None, error
    if about_one(name):
        refusals = [guarded.call(name, link, {**ids, "scene_id": scene}) for scene in (other_id, uuid.uuid4().hex)]
        assert [error is not None and rpc_refusal(error).reason for error in refusals] == ["NOT_FOUND"] * 2
        texts = {without_ids(rpc_refusal(error).detail) for error in refusals if error is not None}
        assert len(texts) == 1


@pytest.mark.parametrize("route", [route for route in ROUTES if rule_of(route).role is not None])
def test_every_route_with_a_link(guarded: Guarded, link: str, other_id: str, route: str) -> None:
    response = guarded.send(route, link, guarded.shared)
    if not rule_of(route).shared:
        assert response.status_code == 403, response.text
        return
    if route.endswith("/goal"):
        assert rest_refusal(response).details["field"] == "scene_id"
    else:
        assert response.status_code == 200, response.text
    if "{scene_id}" in route:
        assert rest_refusal(guarded.send(route, link, {**guarded.shared, "scene_id": other_id})).code == 404


def test_what_a_link_may_call_is_listed() -> None:
    assert {name for name in RPCS if rule_of(SERVICE + name).shared} == _LINK_CALLS


def test_lists_and_questions_to_all_show_the_one_scene(guarded: Guarded, link: str, other_id: str) -> None:
    scene_id = guarded.shared["scene_id"]
    with _client(guarded, link) as client:
        assert [scene.id for scene in client.scenes()] == [scene_id]
    answers = guarded.faces.rest.get("/query", params={"text": "mug"}, headers=guarded.header(link)).json()["answers"]
    assert {answer["scene_id"] for answer in answers} == {scene_id}
    listed = guarded.faces.rpc.ListScenes(pb.ListScenesRequest(), metadata=guarded.metadata(link)).scenes
    assert [scene.id for scene in listed] == [scene_id]


def test_names_of_other_scenes_are_not_suggested_to_a_link(guarded: Guarded, link: str) -> None:
    store = guarded.service._store
    link_store = store.in_project("default", guarded.shared["scene_id"])
    other_id = add_scene(guarded.service, guarded.settings)
    add_known_name(guarded.service, other_id, "a secret")
    assert link_store.only_scene and not store.only_scene
    with _client(guarded, link) as client:
        for obj in client.objects(guarded.shared["scene_id"]):
            assert not [suggestion for suggestion in obj.suggestions if suggestion.scene_id]


def test_a_link_shows_nobody_s_key_name(guarded: Guarded) -> None:
    scene_id = add_scene(guarded.service, guarded.settings)
    guarded.keys["Ada"] = guarded.service.admin.keys.create("Ada", "editor")[1]
    with _client(guarded, "Ada") as editor:
        editor.edit_scene(scene_id, [Edit("recolor", label="mug", color=(0.0, 0.0, 1.0))])
        assert [version.author for version in editor.versions(scene_id)] == ["", "Ada"]
    with _client(guarded, "admin") as admin:
        guarded.keys["visitor"] = admin.keys.share(scene_id, "for Eve", 3600.0).secret
    with _client(guarded, "visitor") as visitor:
        assert [version.author for version in visitor.versions(scene_id)] == ["", ""]
    metadata = guarded.metadata("visitor")
    listed = guarded.faces.rpc.ListVersions(pb.ListVersionsRequest(scene_id=scene_id), metadata=metadata)
    assert [version.author for version in listed.versions] == ["", ""]


def test_links_are_listed_by_scene_and_revoked(guarded: Guarded) -> None:
    scene_id = add_scene(guarded.service, guarded.settings)
    with _client(guarded, "admin") as admin:
        new_key = admin.keys.share(scene_id, "for a day", 86_400.0)
        assert new_key.key.scene_id == scene_id and new_key.key.role == "reader" and new_key.key.expires_at is not None
        assert [key.id for key in admin.keys.all(scene_id)] == [new_key.key.id]
        assert new_key.key.id in {key.id for key in admin.keys.all()}
        assert share_link("https://x/", new_key) == f"https://x/#/scenes/{scene_id}?share={new_key.secret}"
        with client_of(guarded.faces, key=new_key.secret) as visitor:
            assert visitor.scene(scene_id).id == scene_id
            with pytest.raises(PermissionDeniedError):
                list(visitor.keys.all())
        admin.keys.revoke(new_key.key.id)
        with client_of(guarded.faces, key=new_key.secret) as visitor, pytest.raises(UnauthenticatedError):
            _until_refused(visitor, scene_id)
        with pytest.raises(NotFoundError):
            admin.keys.share(uuid.uuid4().hex, "for nothing", 60.0)
    with _client(guarded, "stranger") as stranger, pytest.raises(NotFoundError):
        stranger.keys.share(scene_id, "of another project", 60.0)


def _until_refused(client: Client, scene_id: str) -> None:
    for _ in range(5_000):  # a server looks at the keys again after a second
        client.scene(scene_id)


def test_a_link_expires_and_only_looks(guarded: Guarded) -> None:
    scene_id = guarded.shared["scene_id"]
    for body in (KeyIn("for ever", "reader", None, scene_id), KeyIn("an editor", "editor", 60.0, scene_id)):
        with pytest.raises(InvalidInputError):
            guarded.service.keys.create("operator", body)


def test_the_links_of_a_scene_that_was_deleted_are_revoked(guarded: Guarded) -> None:
    scene_id = add_scene(guarded.service, guarded.settings)
    new_key = guarded.service.keys.create("admin", KeyIn("link", "reader", 60.0, scene_id))
    guarded.service.delete_scene(scene_id)
    (key,) = guarded.service.keys.list("admin", scene_id=scene_id).keys
    assert (key.id, key.state) == (new_key.key.id, "REVOKED")


def test_where_nobody_needs_a_key_a_link_is_refused(faces: Faces, scene_id: str) -> None:
    with client_of(faces) as client, pytest.raises(ConflictError):
        client.keys.share(scene_id, "a link", 60.0)
