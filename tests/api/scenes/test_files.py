"""Files and pictures of a scene: what other programs read, and what HTTP has for large downloads."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from PIL import Image

from fastsplat.service.application.service import SceneService
from fastsplat.service.store.blobs.file_digests import DIGESTS, write_digests
from fastsplat_client import Client
from fastsplat_contract.codec.json_codec import from_plain
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.photos.pictures import PictureRequest
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.made_scene import LABELS, turned
from tests.api.served import Faces, rest_refusal


def test_a_download_continues_where_it_broke(faces: Faces, service: SceneService, scene_id: str) -> None:
    path, version = service.answers.scene_ply(scene_id)
    truth, url = path.read_bytes(), f"/v1/scenes/{scene_id}/scene.ply"
    whole = faces.rest.get(url)
    tag = whole.headers["etag"]
    assert whole.content == truth and whole.headers["accept-ranges"] == "bytes" and not tag.startswith("W/")
    assert version in tag
    rest = faces.rest.get(url, headers={"Range": "bytes=100-", "If-Range": tag})
    assert (rest.status_code, rest.content) == (206, truth[100:])
    assert rest.headers["content-range"] == f"bytes 100-{len(truth) - 1}/{len(truth)}"
    anew = faces.rest.get(url, headers={"Range": "bytes=100-", "If-Range": '"other"'})
    assert (anew.status_code, anew.content) == (200, truth)
    assert faces.rest.get(url, headers={"Range": "bytes=-7"}).content == truth[-7:]
    assert faces.rest.get(url, headers={"Range": "bytes=5-1"}).content == truth  # invalid is as good as none
    assert faces.rest.get(url, headers={"Range": "lines=1-2"}).content == truth
    beyond = rest_refusal(faces.rest.get(url, headers={"Range": f"bytes={len(truth)}-"}))
    assert (beyond.code, beyond.reason) == (416, "RANGE_NOT_SATISFIABLE")
    assert b"".join(chunk.data for chunk in faces.rpc.ExportScene(pb.ExportSceneRequest(scene_id=scene_id))) == truth


def test_a_file_with_a_flipped_bit_is_not_sent(faces: Faces, service: SceneService, scene_id: str) -> None:
    path, _ = service.answers.scene_ply(scene_id)
    whole = path.read_bytes()
    write_digests(path.parent)
    try:
        path.write_bytes(bytes([*whole[:-1], whole[-1] ^ 1]))
        refusal = rest_refusal(faces.rest.get(f"/v1/scenes/{scene_id}/scene.ply"))
        assert (refusal.code, refusal.reason, refusal.details["field"]) == (500, "SCENE_DAMAGED", "scene.ply")
    finally:
        path.write_bytes(whole)
        (path.parent / DIGESTS).unlink()


@pytest.mark.parametrize("viewpoint", ["front.png", turned(0.2)], ids=["view", "camera"])
def test_label_maps_are_16_bit_pictures_of_label_ids(
    faces: Faces, client: Client, scene_id: str, viewpoint: str | PosedCamera
) -> None:
    labels = client.label_map(scene_id, viewpoint)
    assert labels.dtype == np.uint16 and labels.shape == (36, 48)
    assert set(np.unique(labels)) == {0, 1, 2, 3}
    picture = Image.open(io.BytesIO(client.picture(scene_id, "label_map", viewpoint)))
    assert picture.mode == "I;16" and (np.asarray(picture) == labels).all()
    for number, label in enumerate(LABELS, start=1):
        fields = {"views": [viewpoint]} if isinstance(viewpoint, str) else {"cameras": [viewpoint]}
        (answer,) = client.query(scene_id, label, outputs=["mask2d"], **fields)
        assert (answer.masks[0].array() == (labels == number)).mean() > 0.97
    if isinstance(viewpoint, str):
        got = faces.rest.get(f"/v1/scenes/{scene_id}/label_map.npy", params={"view": viewpoint})
        assert (np.load(io.BytesIO(got.content)) == labels).all()


def test_depth_is_meters_as_an_array_and_steps_as_a_picture(faces: Faces, client: Client, scene_id: str) -> None:
    depth = client.depth(scene_id, "front.png")
    seen = depth > 0
    assert depth.dtype == np.float32 and seen.any() and not seen.all()
    assert 3.0 < np.median(depth[seen]) < 5.0
    for scale in (0.0, 0.01):
        picture = Image.open(io.BytesIO(client.picture(scene_id, "depth", "front.png", depth_scale=scale)))
        step = float(picture.text["depth_scale"])
        assert step == (scale or 0.001)
        assert np.abs(np.asarray(picture) * step - depth).max() <= step / 2 + 1e-6
    near = np.asarray(Image.open(io.BytesIO(client.picture(scene_id, "depth", "front.png", depth_scale=1e-6))))
    assert (near[seen] == 65_535).all() and not near[~seen].any()
    assert Image.open(io.BytesIO(client.picture(scene_id, "depth_picture", "front.png"))).mode == "RGB"
    with pytest.raises(InvalidInputError):
        client._render("front.png", PictureRequest(scene_id, "rgb", format="npy"))
    assert faces.rest.get(f"/v1/scenes/{scene_id}/rgb.npy", params={"view": "front.png"}).status_code == 400


def test_an_object_map_shows_what_a_click_finds(client: Client, scene_id: str) -> None:
    ids = client.object_map(scene_id, "front.png")
    picture = Image.open(io.BytesIO(client.picture(scene_id, "object_map", "front.png")))
    np.testing.assert_array_equal(np.asarray(picture), ids)
    present = np.unique(ids[ids > 0]).tolist()
    assert ids.dtype == np.uint16 and len(present) > 1
    assert set(present) <= {obj.id for obj in client.objects(scene_id)}
    for number in present:
        row, column = np.argwhere(ids == number)[0].tolist()
        picked = client.pick(scene_id, "front.png", pixel=(column + 0.5, row + 0.5))
        assert picked.object.id == number
        np.testing.assert_array_equal(picked.mask.array(), ids == number)


def test_normals_and_confidence_are_those_of_the_scene(
    faces: Faces, client: Client, service: SceneService, scene_id: str
) -> None:
    normals, confidence = client.normals(scene_id, "front.png"), client.confidence(scene_id, "front.png")
    depth = client.depth(scene_id, "front.png")
    there = depth > 0
    assert normals.shape == (36, 48, 3) and confidence.shape == (36, 48) and there.any()
    np.testing.assert_allclose(np.linalg.norm(normals[there], axis=-1), 1, atol=1e-5)
    assert not normals[~there].any() and not confidence[~there].any()
    assert (confidence[there] > 0).all() and (confidence <= 1).all()
    array = faces.rest.get(f"/v1/scenes/{scene_id}/normals.npy", params={"view": "front.png"}).content
    np.testing.assert_array_equal(np.load(io.BytesIO(array)), normals)
    picture = np.asarray(Image.open(io.BytesIO(client.picture(scene_id, "normals", "front.png")))) / 127.5 - 1
    np.testing.assert_allclose(picture[there], normals[there], atol=0.005)
    gray = np.asarray(Image.open(io.BytesIO(client.picture(scene_id, "confidence", "front.png")))) / 65_535
    np.testing.assert_allclose(gray, confidence, atol=1e-5)
    refusal = rest_refusal(
        faces.rest.post(
            f"/v1/scenes/{scene_id}:render", json={"kind": "normals", "view": "front.png", "format": "jpeg"}
        )
    )
    assert refusal.details["field"] == "format"


def _poses(service: SceneService, scene_id: str) -> dict[str, PosedCamera]:
    return {posed.name: posed for posed in service.get_scene(scene_id).cameras}


def test_cameras_as_json_can_be_sent_back(faces: Faces, client: Client, service: SceneService, scene_id: str) -> None:
    listed = json.loads(client.export(scene_id, "camera_list"))["cameras"]
    poses = _poses(service, scene_id)
    assert [camera["name"] for camera in listed] == list(poses)
    for camera in listed:
        assert from_plain(PosedCamera, camera)
        body = {"kind": "rgb", "camera": camera}
        view = faces.rest.get(f"/v1/scenes/{scene_id}/rgb.png", params={"view": camera["name"]})
        assert faces.rest.post(f"/v1/scenes/{scene_id}:render", json=body).content == view.content


def test_cameras_as_transforms_have_opengl_axes(client: Client, service: SceneService, scene_id: str) -> None:
    frames = json.loads(client.export(scene_id, "transforms"))["frames"]
    for frame, posed in zip(frames, _poses(service, scene_id).values(), strict=True):
        pose = np.array(frame["transform_matrix"])
        assert frame["file_path"] == posed.name and (frame["w"], frame["fl_x"]) == (48, 45.0)
        assert pose[:3, 3] == pytest.approx(posed.world_from_camera[:3, 3])
        assert pose[:3, 2] == pytest.approx(-posed.world_from_camera[:3, 2])  # backward, not forward
