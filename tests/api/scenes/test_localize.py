"""Photos localized over both protocols, by the command line and in process; hostile ones refused alike."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import grpc
import httpx
import numpy as np
import pytest
from PIL import Image

from fastsplat.service.application.answering.localizing import MAX_PHOTOS_BYTES
from fastsplat.service.application.service import SceneService
from fastsplat.service.capture.capture_settings import PhotoSettings
from fastsplat.service.capture.captures import Capture, CaptureReport, View
from fastsplat.service.capture.photos.scene_photos import write_photos
from fastsplat.service.common.radial_lens import RadialLens
from fastsplat.service.localization.localization_settings import LocalizationSettings
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_contract.codec.json_codec import from_plain
from fastsplat_contract.codec.proto_codec import from_proto, to_proto
from fastsplat_contract.errors import FastSplatError, NotReadyError
from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3, quaternion_of, vector3
from fastsplat_contract.photos.localization import Localization, LocalizeRequest
from tests.api.clients import assert_same
from tests.api.made_scene import ENCODER, LABELS, PLAIN_PNG
from tests.api.scenes.test_observations import add_room
from tests.api.served import Faces, rest_refusal, rpc_refusal
from tests.api.uploaded import huge_png
from tests.capture.upload_files import encoded
from tests.commands import invoke
from tests.localization.textured_room import looking, renderer, textured_room, through_lens
from tests.scenes import store_scene

_POSED = looking(0.11, height=1.15, away=2.45)
_LIMITS = LocalizationSettings()
_ORIGIN = Pose(Vector3(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    return renderer(textured_room(block=True)).colors(_POSED)


@pytest.fixture(scope="module")
def room_id(service: SceneService, api_settings: Settings) -> str:
    """A room with its photos; the block of `picture` is not in it."""
    return add_room(service, api_settings, block=False)


def test_every_face_says_the_same_place(
    faces: Faces, service: SceneService, client: Client, room_id: str, picture: np.ndarray, tmp_path: Path
) -> None:
    photos = (encoded(picture), PLAIN_PNG)
    request = LocalizeRequest(scene_id=room_id, photos=photos, focals=(420.0, 30.0))
    truth = service.localizing.localize(request)
    assert_same(from_proto(Localization, faces.rpc.Localize(to_proto(request))), truth)
    paths = [tmp_path / name for name in ("room.png", "plain.png")]
    for path, content in zip(paths, photos, strict=True):
        path.write_bytes(content)
    assert_same(client.localize(room_id, paths, focals=(420.0, 30.0)), truth)
    options = ["--focal", "420", "--focal", "30", "--json", "--server", str(faces.rest.base_url)]
    printed = invoke("scenes", "localize", room_id, *map(str, paths), *options)
    assert printed.exit_code == 1  # one has no place
    assert_same(from_plain(Localization, json.loads(printed.stdout)), truth)

    found, refused = truth.photos
    assert truth.version == service.versions.resolve(room_id) and truth.meters
    assert found.refusal is None and found.camera is not None and refused.refusal == "no_keypoints"
    off = found.camera.world_from_camera[:3, 3] - _POSED.world_from_camera[:3, 3]
    assert np.linalg.norm(off) < 0.02 and len(found.covariance) == 36
    assert {obj.name for obj in found.objects} == set(LABELS)
    assert truth.changes == truth.looked_at == found.differences == ()  # one photo with a place tells of no change
    assert refused.camera is None and refused.covariance == refused.objects == refused.differences == ()


def test_the_lens_of_a_scenes_photos_is_kept_with_them(
    service: SceneService, api_settings: Settings, tmp_path: Path
) -> None:
    encoder = open_text_encoder(ENCODER, api_settings.models)
    scene = textured_room(labels=LABELS, encoder=encoder, templates=QuerySettings().templates)
    scene_id, drawn, lens = store_scene(service._store, scene, "lens"), renderer(scene), RadialLens(0.875, 0.2)
    views = []
    for number, posed in enumerate(scene.cameras):
        path = tmp_path / f"{number}.png"
        path.write_bytes(encoded(drawn.colors(posed)))
        views.append(View(posed, path, lens=lens))
    points = np.zeros((0, 3), np.float32)
    report = CaptureReport("images", len(views))
    capture = Capture(tuple(views), points, points.astype(np.uint8), scene.scale, report)
    folder = service._store.blobs.version(scene_id, service.versions.resolve(scene_id))
    write_photos(capture, folder, PhotoSettings())
    sent = encoded(through_lens(drawn.colors(_POSED), lens.k1))
    (found,) = service.localizing.localize(LocalizeRequest(scene_id=scene_id, photos=(sent,))).photos
    assert (found.focal_source, found.radial) == ("scene", lens.k1)
    assert found.camera is not None and found.differences == ()
    assert np.linalg.norm(found.camera.world_from_camera[:3, 3] - _POSED.world_from_camera[:3, 3]) < 0.01


def test_a_turned_photo_is_localized_upright(client: Client, room_id: str, picture: np.ndarray) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6  # stored a quarter turn to the left
    turned = encoded(np.rot90(picture).copy(), "JPEG", quality=95, exif=exif)
    upright, stored = client.localize(room_id, [encoded(picture), turned]).photos
    assert upright.camera is not None and stored.camera is not None
    assert (stored.camera.camera.width, stored.camera.camera.height) == (480, 360)
    np.testing.assert_allclose(stored.camera.world_from_camera, upright.camera.world_from_camera, atol=0.01)


def test_photos_that_know_of_each_other(client: Client, room_id: str, picture: np.ndarray) -> None:
    neighbor = looking(-0.15, height=1.2)
    photos = [encoded(picture), encoded(renderer(textured_room()).colors(neighbor))]
    poses = [
        Pose(vector3(posed.world_from_camera[:3, 3]), quaternion_of(posed.world_from_camera[:3, :3]))
        for posed in (_POSED, neighbor)
    ]
    answer = client.localize(room_id, photos, poses=poses)
    for photo, posed in zip(answer.photos, (_POSED, neighbor), strict=True):
        assert photo.camera is not None
        off = photo.camera.world_from_camera[:3, 3] - posed.world_from_camera[:3, 3]
        assert np.linalg.norm(off) < 0.03


_HOSTILE: dict[str, tuple[dict[str, Any], str]] = {
    "no photo": ({"photos": ()}, "photos"),
    "an empty file": ({"photos": (b"",)}, "photos[0]"),
    "no image": ({"photos": (b"GIF89a not an image",)}, "photos[0]"),
    "the second is no image": ({"photos": (PLAIN_PNG, b"text")}, "photos[1]"),
    "cut short": ({"photos": (PLAIN_PNG[:-30],)}, "photos[0]"),
    "far too many pixels": ({"photos": (huge_png(),)}, "photos[0]"),
    "too many photos": ({"photos": (PLAIN_PNG,) * (_LIMITS.max_photos + 1)}, "photos"),
    "focals for others": ({"photos": (PLAIN_PNG,) * 3, "focals": (1.0, 2.0)}, "focals"),
    "a focal of nothing": ({"photos": (PLAIN_PNG,), "focals": (0.0,)}, "focals[0]"),
    "poses for others": ({"photos": (PLAIN_PNG,), "poses": (_ORIGIN,) * 2}, "poses"),
    "no such version": ({"photos": (PLAIN_PNG,), "version": "none"}, "version"),
}


@pytest.mark.parametrize("case", _HOSTILE)
def test_hostile_requests_are_refused_alike(faces: Faces, service: SceneService, room_id: str, case: str) -> None:
    fields, field = _HOSTILE[case]
    request = LocalizeRequest(scene_id=room_id, **fields)
    with pytest.raises(FastSplatError) as caught:
        service.localizing.localize(request)
    assert caught.value.field == field
    with pytest.raises(grpc.RpcError) as over_grpc:
        faces.rpc.Localize(to_proto(request))
    assert rpc_refusal(over_grpc.value).reason == caught.value.reason
    refused = rest_refusal(_post(faces, request))
    assert (refused.reason, refused.details["field"]) == (caught.value.reason, field)
    assert case == "too many photos" or refused.detail == rpc_refusal(over_grpc.value).detail == caught.value.message


def _post(faces: Faces, request: LocalizeRequest, **fields: str) -> httpx.Response:
    form: list[tuple[str, Any]] = [("photos", ("a", content)) for content in request.photos]
    form += [("focals", (None, str(focal))) for focal in request.focals]
    form += [
        ("poses", (None, json.dumps({"position": pose.position._asdict(), "orientation": pose.orientation._asdict()})))
        for pose in request.poses
    ]
    form += [("version", (None, request.version)), *((name, (None, text)) for name, text in fields.items())]
    return faces.rest.post(f"/v1/scenes/{request.scene_id}:localize", files=form)


@pytest.mark.parametrize(
    ("fields", "field"),
    [({"focals": "wide"}, "focals[0]"), ({"poses": "{"}, "poses[0]"), ({"other": "1"}, "other"), ({"poses": "1"}, "")],
)
def test_forms_that_are_none_are_refused(faces: Faces, room_id: str, fields: dict[str, str], field: str) -> None:
    refused = rest_refusal(_post(faces, LocalizeRequest(scene_id=room_id, photos=(PLAIN_PNG,)), **fields))
    assert refused.code == 400 and (not field or refused.details["field"] == field)


def test_more_bytes_than_may_be_are_refused_before_they_are_all_read(faces: Faces, room_id: str) -> None:
    huge = LocalizeRequest(scene_id=room_id, photos=(b"\0" * (MAX_PHOTOS_BYTES + 1),))
    refused = rest_refusal(_post(faces, huge))
    assert refused.code in (400, 413) and refused.details["field"] == "photos"
    assert refused.details["limit"] == f"{MAX_PHOTOS_BYTES} bytes, all photos together"


def test_a_scene_without_photos_says_so(service: SceneService, api_settings: Settings, client: Client) -> None:
    encoder = open_text_encoder(ENCODER, api_settings.models)
    scene = textured_room(cameras=2, labels=LABELS, encoder=encoder, templates=QuerySettings().templates)
    scene_id = store_scene(service._store, scene, "bare")
    with pytest.raises(NotReadyError, match="no photos are kept"):
        client.localize(scene_id, [PLAIN_PNG])
