"""The frame of an aligned scene: one name in all answers, whose cameras can be sent back as they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_client import Client, StandingQuestion
from fastsplat_contract.codec.json_codec import from_plain
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.places import Alignment, KnownLength, Place
from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3
from fastsplat_contract.geometry.thing_prompts import Pixel, ThingPrompt
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.messages.scenes import Edit
from tests.api.calls import CALLS, Refused, in_process, over_grpc, over_rest
from tests.api.scenes.test_observations import add_room, drawn_photos
from tests.api.served import Faces

_TURN = Pose(Vector3(5.0, 0.0, -1.0), Quaternion(0.0, 0.0, 0.6, 0.8))
_PIXEL, _ASIDE = Pixel(200.5, 200.5), Pixel(280.5, 200.5)


def _answers(faces: Faces, scene_id: str) -> Iterator[Any]:
    """JSON of photos of another day, of all calls that need a scene alone, and of its camera file."""
    url = f"/v1/scenes/{scene_id}"
    form = [*(("photos", ("a", content)) for content in drawn_photos(block=False)), ("focals", (None, b"420"))]
    for path in (":localize", "/observations"):
        yield faces.rest.post(url + path, files=form).raise_for_status().json()
    alone = [call.route[4:] for name, call in CALLS.items() if call.route.startswith("GET") and name != "ListVersions"]
    for route in (*alone, "/v1/scenes/{scene_id}/scene.camera_list"):  # versions repeat what was sent
        if "{scene_id}" in route and route.count("{") == 1:
            answer = faces.rest.get(route.format(scene_id=scene_id))
            yield answer.json() if answer.is_success else {}


def _found(value: Any, key: str) -> Iterator[Any]:
    """All objects inside a JSON value that have such a key."""
    if isinstance(value, dict) and key in value:
        yield value
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from _found(inner, key)


def _requests(camera: PosedCamera) -> dict[str, tuple[str, dict[str, Any]]]:
    """Calls that take a camera, by the field that names its frame."""
    place, aside = Place(camera, pixel=_PIXEL), Place(camera, pixel=_ASIDE)
    scale = Edit("scale", known_lengths=(KnownLength(place, aside, 1.0),))
    return {
        "camera": ("RenderView", {"kind": "rgb", "camera": camera}),
        "camera ": ("PickThing", {"camera": camera, "pixel": _PIXEL}),
        "places[0].camera": ("MeasureScene", {"places": (place,)}),
        "edits[0].known_lengths[0].first.camera": ("EditScene", {"edits": (scale,)}),
        "edits[0].prompt.camera": (
            "EditScene",
            {"edits": (Edit("add", prompt=ThingPrompt(camera, pixels=(_PIXEL,))),)},
        ),
    }


def _query(client: Client, scene_id: str, way: Any, *cameras: PosedCamera, version: str = "") -> None:
    request = QueryRequest(scene_id, ("elephant",), outputs=frozenset({"mask2d"}), version=version)
    if way == "stream":
        assert list(client.stream_query(StandingQuestion(request), cameras))
    else:
        assert len(client.ask(replace(request, cameras=cameras), protocol=way)[0].masks) == len(cameras)


@pytest.mark.parametrize("frame", ["world", "hall"])
def test_all_answers_name_one_frame_and_take_their_cameras_back(
    faces: Faces, service: SceneService, api_settings: Settings, client: Client, frame: str
) -> None:
    room = add_room(service, api_settings)
    first = client.scene(room).version
    if frame == "hall":
        client.align_scene(room, Alignment(frame, _TURN))
    answers, version = list(_answers(faces, room)), client.scene(room).version
    assert {each["frame_id"] for each in _found(answers, "frame_id")} == {frame}
    assert [len(list(_found(each, "frame_id"))) > 0 for each in answers].count(True) == 7
    sent = list(_found(answers, "intrinsics"))
    cameras = [from_plain(PosedCamera, each) for each in {str(each): each for each in sent}.values()]
    ways = ((in_process, service), (over_rest, faces), (over_grpc, faces))
    _query(client, room, "REST", *cameras)
    for way in ("gRPC", "stream"):
        _query(client, room, way, cameras[0], cameras[-1])
    names = (cameras[-1].frame_id, "world", "")
    for posed, (ask, place) in zip((replace(cameras[0], frame_id=name) for name in names), ways, strict=True):
        for field, (name, request) in _requests(posed).items():
            answer = ask(place, name, {"scene_id": room}, request)
            if isinstance(answer, Refused):  # the camera is taken, but at its pixel there is no further thing
                assert (f"{answer.details['field']}.camera", field) == (field, "edits[0].prompt.camera")
        service.versions.restore(room, version)

    foreign = replace(cameras[0], frame_id="kitchen")
    accepted = "world" if frame == "world" else '"hall" or "world"'
    for field, (name, request) in _requests(foreign).items():
        for ask, place in ways:
            refused = ask(place, name, {"scene_id": room}, request)
            assert isinstance(refused, Refused) and "kitchen" in refused.detail, refused
            assert refused.details["field"] == f"{field.strip()}.frame_id" and accepted in refused.details["hint"]
    for way, field in (("REST", "cameras[0]"), ("gRPC", "cameras[0]"), ("stream", "pose.camera")):
        with pytest.raises(InvalidInputError, match="kitchen") as caught:
            _query(client, room, way, foreign)
        assert caught.value.field == f"{field}.frame_id"
    if frame == "hall":  # the version before is in another frame, and a map without a name is called so
        with pytest.raises(InvalidInputError, match="hall"):
            _query(client, room, "gRPC", cameras[0], version=first)
        client.align_scene(room, Alignment("", _TURN))
        assert client.detection_page(room).frame_id == client.scene(room).cameras[0].frame_id == "map"
    service.delete_scene(room)
