"""Keys for one upload: what they open, that they make one scene, and how long they live."""

from __future__ import annotations

import time
import uuid
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from pathlib import Path

import grpc
import httpx
import pytest
from sqlalchemy import update

from fastsplat.service.application.service import SceneService
from fastsplat.service.application.upload_keys import OneUpload
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.settings import Settings
from fastsplat.service.store.rows.database import transaction
from fastsplat.service.store.rows.schema import api_keys
from fastsplat_client import Client
from fastsplat_contract.codec.proto_codec import from_proto
from fastsplat_contract.errors import (
    ConflictError,
    InvalidInputError,
    LimitExceededError,
    NotFoundError,
    PermissionDeniedError,
)
from fastsplat_contract.jobs.operations import SceneOptions
from fastsplat_contract.server.keys import NewKey
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import client_of
from tests.api.guarded import Guarded
from tests.api.made_scene import ENCODER, made_scene
from tests.api.served import Faces, rpc_refusal
from tests.api.uploaded import PIECE, TUS, announced, photo, zipped
from tests.at_once import at_once
from tests.scenes import store_scene


@dataclass(frozen=True)
class _Place:
    """A project of the test's own on a server, and what its data folder held before."""

    faces: Faces
    service: SceneService
    settings: Settings
    project: str
    editor: str
    before: frozenset[str]

    def client(self, key: str) -> Client:
        return client_of(self.faces, key=key)

    def uploads(self) -> list[str]:
        """Ids of the uploads of this test."""
        return [upload for upload in self.service._store.blobs.ids("uploads") if upload not in self.before]

    def link(self, lifetime_s: float | None = None) -> NewKey:
        with self.client(self.editor) as client:
            return client.keys.create_for_upload(lifetime_s)


@pytest.fixture
def place(guarded: Guarded) -> _Place:
    project = uuid.uuid4().hex[:8]
    guarded.service.admin.projects.create(project)
    editor = guarded.service.admin.keys.create("Ada", "editor", project=project)[1]
    before = frozenset(guarded.service._store.blobs.ids("uploads"))
    service = guarded.service.in_project(project)
    return _Place(guarded.faces, service, guarded.settings, project, editor, before)


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    path = tmp_path / "capture.zip"
    path.write_bytes(zipped(3))
    return path


def test_an_editor_makes_one_and_a_reader_does_not(place: _Place) -> None:
    link = place.link()
    assert (link.key.role, link.key.state, link.key.operation_id) == ("uploader", "VALID", "")
    assert link.key.expires_at is not None and link.key.expires_at - link.key.created_at == timedelta(minutes=15)
    metadata = (("authorization", f"Bearer {place.editor}"),)
    over_rpc = place.faces.rpc.CreateUploadKey(pb.CreateUploadKeyRequest(lifetime_s=60.0), metadata=metadata)
    assert from_proto(NewKey, over_rpc).key.role == "uploader"
    with pytest.raises(InvalidInputError):
        place.link(3_601.0)
    with place.client(place.service.admin.keys.create("Bo", "reader", project=place.project)[1]) as reader:
        with pytest.raises(PermissionDeniedError):
            reader.keys.create_for_upload()
        with pytest.raises(PermissionDeniedError):
            reader.keys.create("x", "uploader")


def test_it_posts_one_scene_follows_its_job_and_does_nothing_else(place: _Place, capture: Path) -> None:
    scene = made_scene(open_text_encoder(ENCODER, place.settings.models))
    other_id = store_scene(place.service._store, scene, project=place.project)
    link = place.link()
    with place.client(link.secret) as phone:
        before = phone.server_status()
        assert (before.role, before.upload_operation, before.models, before.addresses) == ("uploader", "", (), ())
        operation = phone.create_scene(capture, name="by phone")
        assert phone.operation(operation.id).state == "QUEUED"
        after = phone.server_status()
        assert after.upload_operation == operation.id and after.key_expires_at is not None
        assert after.key_expires_at - link.key.created_at > timedelta(hours=23)
        with pytest.raises(NotFoundError):
            phone.operation(place.service.get_scene(other_id).operation_id)
        for call in (
            lambda: phone.scene(operation.scene_id),
            lambda: list(phone.scenes()),
            lambda: list(phone.operations()),
            lambda: phone.cancel(operation.id),
            lambda: phone.delete_scene(other_id),
            lambda: list(phone.known_names.all()),
            lambda: list(phone.keys.all()),
            lambda: phone.keys.create_for_upload(),
        ):
            with pytest.raises(PermissionDeniedError):
                call()
        with pytest.raises(ConflictError) as refused:
            phone.create_scene(capture, name="a second one")
        assert "one upload" in refused.value.message
        metadata = (("authorization", f"Bearer {link.secret}"),)
        assert place.faces.rpc.GetOperation(pb.GetOperationRequest(operation_id=operation.id), metadata=metadata)
        with pytest.raises(grpc.RpcError) as denied:
            place.faces.rpc.GetScene(pb.GetSceneRequest(scene_id=other_id), metadata=metadata)
        assert rpc_refusal(denied.value).reason == "PERMISSION_DENIED"
    assert [scene.name for scene in place.service.list_scenes().scenes] == ["by phone", "made"]
    (key,) = [key for key in place.service.keys.list("operator").keys if key.id == link.key.id]
    assert key.operation_id == operation.id


def test_of_two_phones_with_the_same_link_one_makes_the_scene(place: _Place, capture: Path) -> None:
    service, key_id = place.service, place.link().key.id
    sessions = [OneUpload(service, key_id).new_upload() for _ in range(2)]
    for number, session in enumerate(sessions):
        for seed in range(3):
            session.write(f"{seed}.jpg", [photo(10 * number + seed)])
    key = OneUpload(service, key_id)
    outcomes = at_once(*(partial(key.create_scene, session, "by phone", "", SceneOptions()) for session in sessions))
    assert [isinstance(outcome, ConflictError) for outcome in outcomes].count(True) == 1
    assert len(service.list_scenes().scenes) == 1
    assert len(place.uploads()) == 1
    with pytest.raises(ConflictError):
        key.new_upload()


def test_one_that_expires_before_its_scene_is_made_makes_none(place: _Place) -> None:
    link = place.link()
    upload = OneUpload(place.service, link.key.id)
    session = upload.new_upload()
    for number in range(2):
        session.write(f"{number}.jpg", [photo(number)])
    with transaction(place.service._store.engine) as connection:
        connection.execute(update(api_keys).where(api_keys.c.id == link.key.id).values(expires_at=time.time() - 1))
    with pytest.raises(ConflictError):
        upload.create_scene(session, "late", "", SceneOptions())
    assert place.service.list_scenes().scenes == ()
    assert place.uploads() == []


def test_an_upload_that_has_begun_may_take_longer_than_the_link(place: _Place) -> None:
    link = place.link(60.0)
    headers = {**announced("a.zip", 3), "Authorization": f"Bearer {link.secret}"}
    begun = place.faces.rest.post("/v1/uploads", headers=headers)
    assert begun.status_code == 201, begun.text
    record = place.service._store.keys.find(link.key.id)
    assert record is not None and record.expires_at == pytest.approx(record.created_at + 86_400)


def test_it_owns_its_own_upload_and_no_other(place: _Place) -> None:
    """Files of others are as if they were not there; it has one that is not whole, and no more than one upload has."""
    first, second = place.link().secret, place.link().secret

    def call(
        key: str, method: str, path: str, headers: dict[str, str] | None = None, content: bytes = b""
    ) -> httpx.Response:
        sent = {**(headers or TUS), "Authorization": f"Bearer {key}"}
        return place.faces.rest.request(method, path, headers=sent, content=content)

    def create(key: str, length: int) -> httpx.Response:
        return call(key, "POST", "/v1/uploads", announced("a.jpg", length))

    def piece(key: str, path: str, content: bytes) -> int:
        return call(key, "PATCH", path, {**PIECE, "Upload-Offset": "0"}, content).status_code

    for owner in (place.editor, first):
        path = create(owner, 4).headers["location"]
        assert [call(second, method, path).status_code for method in ("HEAD", "DELETE")] == [404, 404]
        assert piece(second, path, b"evil") == 404
        form = place.faces.rest.post(
            "/v1/scenes", headers={"Authorization": f"Bearer {second}"}, files={"uploads": (None, path.split("/")[-1])}
        )
        assert form.status_code == 404
        assert call(place.editor, "HEAD", path).status_code == 200
    refused = create(first, 4)
    assert refused.status_code == 409 and path in refused.json()["hint"]
    assert len(place.uploads()) == 2
    assert piece(first, path, b"good") == 204 and create(first, 4).status_code == 201
    too_much = create(second, place.settings.capture.max_upload_bytes), create(second, 1)
    assert [answer.status_code for answer in too_much] == [201, 413]
    limited = place.settings.capture.model_copy(update={"max_entries": 1})
    key_uploads = place.service.resumable.of_key("some key", limited.max_entries, print)
    key_uploads.create(place.project, "empty.jpg", 0)
    with pytest.raises(LimitExceededError):
        key_uploads.create(place.project, "another.jpg", 0)
    with place.client(second) as phone:
        assert phone.server_status().quotas == ()
