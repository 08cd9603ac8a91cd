"""Uploads of which not all can be taken as it is: photos that are none, and several of one name."""

from __future__ import annotations

import base64
from pathlib import Path

import grpc
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat_contract.errors import CorruptImageError
from fastsplat_contract.operations import SceneOptions
from tests.api.clients import client_of
from tests.api.served import Faces, rest_refusal, rpc_refusal
from tests.api.uploaded import messages, photo, photos, post


def test_a_photo_that_cannot_be_used_is_left_out_over_each_face_or_refused_if_asked(
    faces: Faces, service: SceneService, tmp_path: Path
) -> None:
    files = [*photos(3), ("Zz_bad.jpg", b"holiday notes"), ("cut.jpg", photo(9, (640, 480))[:2_000])]
    for name, content in files:
        (tmp_path / name).write_bytes(content)
    client = client_of(faces)
    operations = [client.create_scene(tmp_path), faces.rpc.CreateScene(messages(files))]
    for operation in operations:
        assert set(operation.left_out) == {"Zz_bad.jpg", "cut.jpg"}
        assert operation.left_out["Zz_bad.jpg"] == "it is not an image this service can read"
    assert dict(operations[1].left_out) == dict(service.get_operation(operations[0].id).left_out)
    for operation in operations:
        service.delete_scene(operation.scene_id)
    with pytest.raises(CorruptImageError, match=r"^Zz_bad\.jpg is not an image"):
        client.create_scene(tmp_path, options=SceneOptions(strict=True))
    rest = rest_refusal(post(faces, files, {"strict": "true"}))
    with pytest.raises(grpc.RpcError) as caught:
        faces.rpc.CreateScene(messages(files, strict=True))
    rpc = rpc_refusal(caught.value)
    assert (rest.reason, rest.details) == (rpc.reason, rpc.details) and rest.details["field"] == "Zz_bad.jpg"


def test_photos_of_one_name_are_all_kept_however_they_come(faces: Faces, service: SceneService) -> None:
    files = [("image.jpg", photo(1)), ("image.jpg", photo(2)), ("image.jpg", photo(3))]
    name = base64.b64encode(b"image.jpg").decode()
    uploads = []
    for _, content in files:
        headers = {"Tus-Resumable": "1.0.0", "Upload-Length": str(len(content)), "Upload-Metadata": f"filename {name}"}
        headers["Content-Type"] = "application/offset+octet-stream"
        made = faces.rest.post("/v1/uploads", headers=headers, content=content)
        uploads.append(("uploads", (None, made.headers["location"].rpartition("/")[2])))
    posted = [post(faces, files), faces.rest.post("/v1/scenes", files=uploads)]
    ids = [answer.json()["id"] for answer in posted] + [faces.rpc.CreateScene(messages(files)).id]
    for operation_id in ids:
        record = service._store.scenes.operation(operation_id)
        manifest, folder = read_manifest(service._store.blobs.upload(record.upload_id) / record.options["validated"])
        kept = {name: (folder / name).read_bytes() for name in manifest.names}
        assert kept == {f"image{end}.jpg": files[i][1] for i, end in enumerate(("", " (2)", " (3)"))}
        assert not manifest.left_out
        service.delete_scene(record.scene_id)
