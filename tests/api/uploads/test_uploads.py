"""Captures over both protocols: taken whole or refused whole, and a refusal leaves nothing behind."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import grpc
import numpy as np
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.scene.formats.zips import zipped
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import CorruptImageError, InvalidInputError, LimitExceededError
from fastsplat_contract.jobs.operations import SceneOptions
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import client_of
from tests.api.conftest import MAX_UPLOAD_BYTES
from tests.api.served import Faces, rest_refusal, rpc_refusal
from tests.api.uploaded import PIECE, Files, announced, messages, photo, photos, post
from tests.waiting import wait_for


def _splat(count: int = 9) -> bytes:
    """A 3DGS PLY."""
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", *(f"scale_{i}" for i in range(3))]
    names += [f"rot_{i}" for i in range(4)]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    header += [f"property float {name}" for name in names]
    rows = np.random.default_rng(0).standard_normal((count, len(names))).astype("<f4")
    return "\n".join([*header, "end_header", ""]).encode() + rows.tobytes()


@pytest.fixture
def untouched(faces: Faces, service: SceneService, api_settings: Settings) -> Iterator[None]:
    """Afterwards no file, scene or operation may be there that was not there before."""

    def state() -> set[Path | str]:
        folders = (api_settings.data_dir / kind for kind in ("uploads", "jobs", "scenes"))
        walks = (walk for folder in folders for walk in os.walk(folder))
        files = {Path(root, name) for root, inner, names in walks for name in inner + names}
        return files | {scene.id for scene in service.list_scenes(500, "")[0]}

    before = state()  # in which there may be what the test before has cut off: of that the server may not know yet
    yield
    wait_for(lambda: state() <= before)  # a connection that was cut is noticed a moment later


def _same_bytes(service: SceneService, operation_id: str, files: Files) -> bool:
    folder = service._store.blobs.upload(service._store.scenes.operation(operation_id).upload_id)
    stored = sorted(path.read_bytes() for path in folder.rglob("*") if path.is_file())
    return all(data in stored for _, data in files)


def test_photos_over_rest_become_an_operation(faces: Faces, service: SceneService) -> None:
    files = photos(3)
    form = {"name": "my room", "labels": ["mug, ball", "story book"], "time_budget_s": "60", "max_gaussians": "5000"}
    response = post(faces, files, form)
    assert response.status_code == 202, response.text
    operation = response.json()
    assert response.headers["location"] == f"/v1/operations/{operation['id']}"
    assert operation["state"] == "QUEUED" and not operation["done"]
    assert faces.rest.get(response.headers["location"]).json()["id"] == operation["id"]
    scene = faces.rest.get(f"/v1/scenes/{operation['scene_id']}").json()
    assert scene["name"] == "my room" and scene["state"] == "TRAINING"
    record = service._store.scenes.operation(operation["id"])
    assert record.options["labels"] == ["mug", "ball", "story book"]
    assert (record.options["time_budget_s"], record.options["max_gaussians"]) == (60.0, 5000)
    assert _same_bytes(service, operation["id"], files)

    early = rest_refusal(faces.rest.get("/query", params={"text": "mug", "scene": operation["scene_id"]}))
    assert (early.code, early.reason) == (409, "NOT_READY")
    cancelled = faces.rest.post(f"/v1/operations/{operation['id']}:cancel").json()
    assert cancelled["state"] == "CANCELLED" and cancelled["done"]
    assert faces.rest.get(f"/v1/scenes/{operation['scene_id']}").json()["state"] == "CANCELLED"
    late = rest_refusal(faces.rest.get("/query", params={"text": "mug", "scene": operation["scene_id"]}))
    assert (late.code, late.reason) == (409, "NOT_READY") and "cancelled" in late.detail
    again = faces.rest.post(f"/v1/operations/{operation['id']}:retry").json()
    assert (again["id"], again["state"], again["done"]) == (operation["id"], "QUEUED", False)
    assert faces.rpc.CancelOperation(pb.CancelOperationRequest(operation_id=operation["id"])).done
    assert not faces.rpc.RetryOperation(pb.RetryOperationRequest(operation_id=operation["id"])).done
    assert faces.rest.delete(f"/v1/scenes/{operation['scene_id']}").status_code == 204
    assert faces.rest.get(f"/v1/scenes/{operation['scene_id']}").status_code == 404


def test_photos_over_grpc_become_an_operation(faces: Faces, service: SceneService) -> None:
    files = photos(3)
    choices = {"labels": ["mug"], "time_budget_s": 60, "preset": "best", "priority": -2}
    operation = faces.rpc.CreateScene(messages(files, name="my room", **choices))
    assert operation.state == pb.OPERATION_STATE_QUEUED and not operation.done
    record = service._store.scenes.operation(operation.id)
    assert (record.options["preset"], record.priority, record.options["labels"]) == ("best", -2, ["mug"])
    wrong = {"preset": "huge"}, {"priority": 101}, {"tolerance_db": 7.0}, {"tolerance_db": 0.3, "preset": "best"}
    for choice in wrong:
        with pytest.raises(grpc.RpcError) as caught:
            faces.rpc.CreateScene(messages(files, **choice))
        assert rpc_refusal(caught.value).details["field"] in choice
    assert _same_bytes(service, operation.id, files)
    watched = faces.rpc.WatchOperation(pb.WatchOperationRequest(operation_id=operation.id))
    assert next(watched).state == pb.OPERATION_STATE_QUEUED
    faces.rpc.CancelOperation(pb.CancelOperationRequest(operation_id=operation.id))
    assert [update.state for update in watched] == [pb.OPERATION_STATE_CANCELLED]
    faces.rpc.DeleteScene(pb.DeleteSceneRequest(scene_id=operation.scene_id))


def test_every_option_arrives_whatever_the_protocol(faces: Faces, service: SceneService) -> None:
    chosen = {"lens": "panorama", "nadir_deg": 25.0, "privacy": "people", "movers": "ignore"}
    posted = post(faces, photos(2), {name: str(value) for name, value in chosen.items()})
    assert posted.status_code == 202, posted.text
    for operation_id in (posted.json()["id"], faces.rpc.CreateScene(messages(photos(2), **chosen)).id):
        record = service._store.scenes.operation(operation_id)
        assert {name: record.options[name] for name in chosen} == chosen
        service.delete_scene(record.scene_id)


@pytest.mark.usefixtures("untouched")
def test_every_option_that_is_not_for_this_upload_is_named(service: SceneService) -> None:
    for files, options, field in (
        ([("own.ply", _splat())], SceneOptions(max_gaussians=8), "max_gaussians"),
        (photos(2), SceneOptions(nadir_deg=81.0), "nadir_deg"),
        ([("own.ply", _splat())], SceneOptions(up="w"), "up"),
        (photos(2), SceneOptions(up="z"), "up"),
        ([("own.ply", _splat())], SceneOptions(privacy="people"), "privacy"),
        ([("own.ply", _splat())], SceneOptions(movers="ignore"), "movers"),
        (photos(2), SceneOptions(privacy="faces"), "privacy"),
        (photos(2), SceneOptions(movers="hide"), "movers"),
        (photos(2), SceneOptions(privacy="people", movers="keep"), "movers"),
        ([("own.ply", _splat())], SceneOptions(lens="fisheye"), "lens"),
        (photos(2), SceneOptions(lens="keyhole"), "lens"),
    ):
        with service.new_upload() as session:
            for name, content in files:
                session.write(name, [content])
            with pytest.raises((InvalidInputError, LimitExceededError)) as caught:
                service.create_scene(session, "", "", options)
        assert caught.value.field == field


def test_one_request_id_makes_one_scene_whatever_the_protocol(faces: Faces) -> None:
    files = photos(2)
    first = post(faces, files, {"name": "once", "request_id": "id-1"})
    again = post(faces, files, {"name": "once", "request_id": "id-1"})
    assert first.status_code == again.status_code == 202 and first.json()["id"] == again.json()["id"]
    assert faces.rpc.CreateScene(messages(files, name="once", request_id="id-1")).id == first.json()["id"]
    refusal = rest_refusal(post(faces, photos(3), {"name": "once", "request_id": "id-1"}))
    assert (refusal.code, refusal.reason, refusal.details["field"]) == (409, "CONFLICT", "request_id")
    faces.rest.delete(f"/v1/scenes/{first.json()['scene_id']}")


# What archives and photos are refused for is stated of the capture; here is one of each kind.
_HOSTILE: dict[str, tuple[Files, tuple[int, str]]] = {
    "no images": ([("notes.txt", b"hello"), ("more.txt", b"hello")], (400, "INVALID_ARGUMENT")),
    "one image": ([("a.jpg", photo(1))], (400, "INVALID_ARGUMENT")),
    "text called jpg": ([("a.jpg", photo(1)), ("b.jpg", b"just text")], (400, "INVALID_ARGUMENT")),
    "name leaves": ([("../../a.jpg", photo(1)), ("b.jpg", photo(2))], (400, "INVALID_ARGUMENT")),
    "absolute name": ([("/etc/a.jpg", photo(1)), ("b.jpg", photo(2))], (400, "INVALID_ARGUMENT")),
    "zip bomb": ([("c.zip", zipped({"a.jpg": bytes(100_000_000)}))], (400, "INVALID_ARGUMENT")),
    "splat of billions": (
        [("own.ply", _splat().replace(b"vertex 9", b"vertex 9000000000"))],
        (413, "RESOURCE_EXHAUSTED"),
    ),
}


_OVER_GRPC_TOO = {"text called jpg", "name leaves", "absolute name", "zip bomb"}
"""Where names are read by each protocol, and one refusal of the photos and of an archive each."""


@pytest.mark.usefixtures("untouched")
@pytest.mark.parametrize("case", _HOSTILE)
def test_a_hostile_upload_is_refused_alike_and_leaves_nothing(faces: Faces, case: str) -> None:
    files, codes = _HOSTILE[case]
    rest = rest_refusal(post(faces, files))
    assert rest.code == codes[0] and rest.detail and rest.details.get("hint", "x")
    if case in _OVER_GRPC_TOO:
        with pytest.raises(grpc.RpcError) as caught:
            faces.rpc.CreateScene(messages(files))
        rpc = rpc_refusal(caught.value)
        assert rpc.code == codes[1] and (rest.reason, rest.details) == (rpc.reason, rpc.details)


@pytest.mark.usefixtures("untouched")
def test_an_upload_over_the_limit_is_refused_while_it_arrives(faces: Faces) -> None:
    boundary = b'--b\r\nContent-Disposition: form-data; name="capture"; filename="c.zip"\r\n\r\n'
    sent = 0

    def endless(pieces: int) -> Iterator[bytes]:  # chunked: no length is announced
        nonlocal sent
        yield boundary
        for _ in range(pieces):
            sent += 2**16
            yield bytes(2**16)

    headers = {"Content-Type": "multipart/form-data; boundary=b"}
    refused = rest_refusal(faces.rest.post("/v1/scenes", content=endless(80), headers=headers))
    assert refused.code == 413 and str(MAX_UPLOAD_BYTES) in refused.details["limit"]

    rest = rest_refusal(faces.rest.post("/v1/scenes", content=boundary + bytes(MAX_UPLOAD_BYTES), headers=headers))
    assert rest.code == 413 and rest.details["field"] == "Content-Length"

    def messages() -> Iterator[pb.CreateSceneRequest]:
        yield pb.CreateSceneRequest(header=pb.CreateSceneHeader())
        yield pb.CreateSceneRequest(file=pb.FileHeader(name="c.zip"))
        for _ in range(1000):
            yield pb.CreateSceneRequest(chunk=bytes(2**16))

    with pytest.raises(grpc.RpcError) as caught:
        faces.rpc.CreateScene(messages())
    assert rpc_refusal(caught.value).code == "RESOURCE_EXHAUSTED"


@pytest.mark.usefixtures("untouched")
@pytest.mark.parametrize(
    ("data", "files", "field"),
    [
        ({"time_budget_s": "soon"}, photos(2), "time_budget_s"),
        ({"time_budget_s": "-1"}, photos(2), "time_budget_s"),
        ({"time_budget_s": "nan"}, photos(2), "time_budget_s"),
        ({"max_gaussians": "1.5"}, photos(2), "max_gaussians"),
        ({"name": ["a", "b"]}, photos(2), "name"),
        ({"colour": "red"}, photos(2), "colour"),
        ({"name": "x"}, [], "Content-Type"),
    ],
)
def test_a_malformed_form_names_its_field(faces: Faces, data: dict[str, object], files: Files, field: str) -> None:
    refused = rest_refusal(post(faces, files, data))
    assert refused.code == 400 and refused.details["field"] == field


@pytest.mark.usefixtures("untouched")
def test_files_come_under_known_fields_only(faces: Faces) -> None:
    file = ("a.jpg", photo(1))
    unknown = rest_refusal(faces.rest.post("/v1/scenes", files=[("photo", file)]))
    assert unknown.code == 400 and unknown.details["field"] == "photo"
    two = rest_refusal(faces.rest.post("/v1/scenes", files=[("capture", file), ("capture", ("b.jpg", photo(2)))]))
    assert two.code == 400 and two.details["field"] == "capture"
    nothing = rest_refusal(faces.rest.post("/v1/scenes", files=[("name", (None, "x"))]))
    assert nothing.code == 400 and nothing.details["field"] == "files"


@pytest.mark.usefixtures("untouched")
def test_messages_out_of_order_are_malformed(faces: Faces) -> None:
    header = pb.CreateSceneRequest(header=pb.CreateSceneHeader())
    file = pb.CreateSceneRequest(file=pb.FileHeader(name="a.jpg"))
    chunk = pb.CreateSceneRequest(chunk=b"x")
    announced = pb.CreateSceneRequest(file=pb.FileHeader(name="a.jpg", size_bytes=3))
    for sent in ([], [file, chunk], [header], [header, chunk], [header, file, header], [header, announced, chunk]):
        with pytest.raises(grpc.RpcError) as caught:
            faces.rpc.CreateScene(iter(sent))
        assert rpc_refusal(caught.value).code == "INVALID_ARGUMENT"


@pytest.mark.usefixtures("untouched")
def test_a_client_that_goes_away_leaves_nothing(faces: Faces) -> None:
    data = b"".join(
        b'--b\r\nContent-Disposition: form-data; name="images"; filename="%s"\r\n\r\n%s\r\n' % (name.encode(), content)
        for name, content in photos(3)
    )
    head = b"POST /v1/scenes HTTP/1.1\r\nHost: x\r\nContent-Type: multipart/form-data; boundary=b\r\n"
    for cut in (1, len(data) // 2, len(data)):
        with socket.create_connection(("127.0.0.1", faces.ports.http)) as connection:
            connection.sendall(head + b"Content-Length: %d\r\n\r\n" % (len(data) + 7) + data[:cut])

    sent, over = threading.Event(), threading.Event()

    def slowly() -> Iterator[pb.CreateSceneRequest]:
        yield from messages(photos(3))
        sent.set()
        over.wait(60)

    call = faces.rpc.CreateScene.future(slowly())
    assert sent.wait(60)
    call.cancel()
    over.set()


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
    uploads = []
    for name, content in files:
        headers = {**announced(name, len(content)), **PIECE}
        upload = faces.rest.post("/v1/uploads", headers=headers, content=content)
        uploads.append(("uploads", (None, upload.headers["location"].rpartition("/")[2])))
    posted = [post(faces, files), faces.rest.post("/v1/scenes", files=uploads)]
    ids = [answer.json()["id"] for answer in posted] + [faces.rpc.CreateScene(messages(files)).id]
    for operation_id in ids:
        record = service._store.scenes.operation(operation_id)
        manifest, folder = read_manifest(service._store.blobs.upload(record.upload_id) / record.options["validated"])
        contents = {name: (folder / name).read_bytes() for name in manifest.names}
        assert contents == {f"image{end}.jpg": files[i][1] for i, end in enumerate(("", " (2)", " (3)"))}
        assert not manifest.left_out
        service.delete_scene(record.scene_id)


@pytest.mark.usefixtures("untouched")
def test_a_deadline_in_mid_upload_leaves_nothing(faces: Faces) -> None:
    def slowly() -> Iterator[pb.CreateSceneRequest]:
        yield from messages(photos(2))
        over.wait(60)

    over = threading.Event()
    with pytest.raises(grpc.RpcError) as caught:
        faces.rpc.CreateScene(slowly(), timeout=0.5)
    over.set()
    assert caught.value.code() is grpc.StatusCode.DEADLINE_EXCEEDED
