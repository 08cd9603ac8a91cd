"""Photos of another day, kept with a scene: over every face, undone, refused, and gone with the scene."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
from PIL import Image

from fastsplat.service.application.editing import observing
from fastsplat.service.application.service import SceneService
from fastsplat.service.capture.capture_settings import PhotoSettings
from fastsplat.service.common.withheld import WithheldReport
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.scene.artefact.scene_facts import SceneFacts
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_contract.codec.json_codec import from_json
from fastsplat_contract.codec.proto_codec import from_proto, to_proto
from fastsplat_contract.errors import (
    ConflictError,
    FastSplatError,
    InvalidInputError,
    LimitExceededError,
    NotFoundError,
)
from fastsplat_contract.geometry.places import Alignment
from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3
from fastsplat_contract.masks import decode_mask3d
from fastsplat_contract.messages.scenes import Color, Edit
from fastsplat_contract.photos.observations import ListObservationsRequest, Observation, ObservationList, ObserveRequest
from tests.api.calls import CALLS
from tests.api.clients import assert_same
from tests.api.made_scene import ENCODER, LABELS, PLAIN_PNG
from tests.api.served import Faces, rest_refusal, rpc_refusal
from tests.capture.upload_files import encoded
from tests.commands import invoke
from tests.localization.textured_room import looking, renderer, textured_room
from tests.scenes import add_photos, store_scene

_CUBE = "elephant"
_MONDAY = datetime(2026, 3, 2, 18, tzinfo=UTC)


def drawn_photos(*, block: bool) -> tuple[bytes, ...]:
    """Three photos of the room, with or without the cube."""
    drawn = renderer(textured_room(block=block))
    views = [looking(angle, height=height) for angle, height in ((-0.5, 1.2), (0.0, 1.7), (0.5, 1.2))]
    return tuple(map(encoded, (drawn.colors(posed) for posed in views)))


@pytest.fixture(scope="module")
def without() -> tuple[bytes, ...]:
    return drawn_photos(block=False)


def add_room(service: SceneService, settings: Settings, *, block: bool = True, **options: Any) -> str:
    """A room in which a cube stands or not, with its photos."""
    encoder = open_text_encoder(ENCODER, settings.models)
    labels = (*LABELS, _CUBE) if block else LABELS
    scene = textured_room(block=block, labels=labels, encoder=encoder, templates=QuerySettings().templates, **options)
    scene_id = store_scene(service._store, scene, "room")
    drawn = renderer(scene)
    add_photos(service._store, scene_id, [Image.fromarray(drawn.colors(posed)) for posed in scene.cameras])
    return scene_id


@pytest.fixture
def room_id(service: SceneService, api_settings: Settings) -> Iterator[str]:
    """For one test: questions to all scenes do not find it."""
    scene_id = add_room(service, api_settings)
    yield scene_id
    if any(scene.id == scene_id for scene in service.list_scenes(500).scenes):
        service.delete_scene(scene_id)


def _request(scene_id: str, photos: Sequence[bytes], **fields: Any) -> ObserveRequest:
    return ObserveRequest(scene_id=scene_id, photos=tuple(photos), focals=(420.0,), **fields)


def _stored_photos(service: SceneService, scene_id: str) -> list[Path]:
    folder = service._store.blobs.version(scene_id, service.versions.resolve(scene_id))
    return sorted((folder / "photos" / "observed").rglob("*.jpg"))


def test_a_cube_that_is_gone_is_kept_found_again_and_undone_over_every_face(
    faces: Faces, service: SceneService, client: Client, room_id: str, without: tuple[bytes, ...], tmp_path: Path
) -> None:
    first = client.scene(room_id).version
    observation = client.observe(room_id, without, focals=(420.0,), seen_at=_MONDAY)
    (gone,) = observation.changes
    assert (gone.kind, gone.name, gone.after) == ("gone", _CUBE, None) and gone.before is not None
    assert (observation.seen_at, observation.seen_at_source, observation.left_out) == (_MONDAY, "given", ())
    assert observation.sentence == gone.sentence and gone.object_id in observation.looked_at
    assert [photo.view for photo in observation.photos] == [f"{observation.id}/{number}" for number in range(3)]
    assert all(set(photo.differences) for photo in observation.photos)

    (version,) = [record for record in client.versions(room_id) if record.current]
    assert (version.version, version.parent) == (observation.id, first)
    assert [edit.action for edit in version.edits] == ["observe"]

    (cube,) = [obj for obj in client.objects(room_id) if obj.id == gone.object_id]
    assert (cube.last_seen, cube.missing_since, cube.seen_in) == (None, _MONDAY, observation.id)
    (answer,) = client.query(room_id, _CUBE, outputs=["objects"])
    assert (answer.outcome, answer.object_ids) == ("not_here", (cube.id,))
    missing = f'The "{_CUBE}" is missing since 2 March 2026.'
    assert answer.sentence == f'Not here any more: "{_CUBE}"; its place is that where it was. {missing}'
    for text in ("What is gone?", "what has changed since 2 March 2026"):
        (reply,) = client.query(room_id, text, outputs=["mask3d"])
        assert (reply.outcome, reply.object_ids, reply.text) == ("here", (cube.id,), text)
        assert reply.sentence == f"By photos of 2 March 2026: {gone.sentence}"
        assert decode_mask3d(reply.mask3d or b"", "bits", reply.gaussians).sum() == cube.gaussian_count
    (reply,) = client.query(room_id, f"when was the {_CUBE} last seen?")
    assert (reply.outcome, reply.sentence) == ("not_here", missing)
    (reply,) = client.query(room_id, f"where was the {_CUBE} on 5 March 2026")
    assert reply.sentence == f"By photos of 2 March 2026, nobody having looked on 5 March 2026: {gone.sentence}"
    (reply,) = client.query(room_id, "what moved?")
    assert (reply.outcome, reply.object_ids) == ("not_here", ())
    assert reply.sentence == "Nothing has moved: photos of 2 March 2026 looked at 4 objects."
    (reply,) = client.query(room_id, "what is gone since 3 March 2026?")
    assert reply.outcome == "cannot_say" and "since 3 March 2026" in reply.sentence
    (reply,) = client.query(room_id, "what is gone", version=first)
    assert reply.sentence == "Cannot say: no photos of another day are kept with this scene."

    path = tmp_path / "tuesday"
    path.mkdir()
    for number, content in enumerate(drawn_photos(block=True)):
        (path / f"{number}.png").write_bytes(content)
    words = ["scenes", "observe", room_id, str(path), "--focal", "420", "--json", "--server", str(faces.rest.base_url)]
    printed = invoke(*words, "--seen-at", "2026-03-03T18:00:00")
    later = from_json(Observation, printed.stdout)
    assert later.changes == () and gone.object_id in later.looked_at and later.seen_at > observation.seen_at

    (cube,) = [obj for obj in client.objects(room_id) if obj.id == gone.object_id]
    assert (cube.last_seen, cube.missing_since, cube.seen_in) == (later.seen_at, None, later.id)
    (reply,) = client.query(room_id, _CUBE)
    assert reply.outcome == "here" and "missing" not in reply.sentence
    (reply,) = client.query(room_id, f"where was the {_CUBE} on 2026-03-02?")
    assert reply.sentence == f"By photos of 2 March 2026: {gone.sentence}"

    whole = tuple(client.observations(room_id))
    assert_same(whole, (later, observation))
    listed = faces.rpc.ListObservations(to_proto(ListObservationsRequest(room_id)))
    assert_same(from_proto(ObservationList, listed).observations, whole)
    assert_same(client.observation(room_id, observation.id), observation)
    listing = invoke("scenes", "observations", room_id, "--server", str(faces.rest.base_url))
    assert gone.sentence in listing.stdout and "None of the 4 objects" in listing.stdout

    client.undo_edit(room_id)
    assert [entry.id for entry in client.observations(room_id)] == [observation.id]
    with pytest.raises(NotFoundError):
        client.observation(room_id, later.id)
    assert [entry.id for entry in client.observations(room_id, version=later.id)] == [later.id, observation.id]
    client.undo_edit(room_id)
    assert list(client.observations(room_id)) == []


def test_both_protocols_keep_the_same(
    faces: Faces, service: SceneService, api_settings: Settings, client: Client, without: tuple[bytes, ...]
) -> None:
    rooms = [add_room(service, api_settings) for _ in range(3)]
    observations = [
        client.observe(rooms[0], without, focals=(420.0,), seen_at=_MONDAY),
        from_proto(Observation, faces.rpc.ObserveScene(to_proto(_request(rooms[1], without, seen_at=_MONDAY)))),
        service.observations.observe(_request(rooms[2], without, seen_at=_MONDAY)),
    ]
    for room in rooms:
        service.delete_scene(room)
    first, *copies = [_without_ids(observation) for observation in observations]
    for copy in copies:
        assert_same(copy, first)


def _without_ids(observation: Observation) -> Observation:
    photos = tuple(photo._replace(view="") for photo in observation.photos)
    return replace(observation, scene_id="", id="", photos=photos)


def test_its_photos_are_kept_without_metadata_follow_edits_and_go_with_the_scene(
    service: SceneService, client: Client, room_id: str, without: tuple[bytes, ...]
) -> None:
    observation = client.observe(room_id, without, focals=(420.0,))
    client.edit_scene(room_id, [Edit("recolor", object_ids=(1,), color=Color(1.0, 0.0, 0.0))])
    files = _stored_photos(service, room_id)
    assert len(files) == len(without)
    content = client.photo(room_id, observation.photos[0].view)
    assert content == files[0].read_bytes()
    with Image.open(io.BytesIO(content)) as photo:
        assert photo.size == (480, 360) and not photo.getexif()
    for view in (f"{observation.id}/3", "e0000000000000000/0", f"{observation.id}/../0"):
        with pytest.raises(NotFoundError):
            client.photo(room_id, view)
    client.delete_scene(room_id)
    assert not any(path.exists() for path in files)


@pytest.mark.parametrize("why", ["off", "private"])
def test_no_photo_stays_where_the_scenes_own_would_not(
    api_settings: Settings, service: SceneService, without: tuple[bytes, ...], why: str
) -> None:
    facts = SceneFacts(withheld=WithheldReport("people", 0, 0.1)) if why == "private" else SceneFacts()
    room = add_room(service, api_settings, facts=facts)
    settings = api_settings.model_copy(update={"photos": PhotoSettings(keep="off")}) if why == "off" else api_settings
    with SceneService(service._store, settings) as second_service:
        observation = second_service.observations.observe(_request(room, without))
    assert [photo.view for photo in observation.photos] == [""] * 3 and len(observation.changes) == 1
    assert _stored_photos(service, room) == []
    service.delete_scene(room)


def _found(value: Any, key: str) -> Iterator[dict[str, Any]]:
    """All objects inside a JSON value that have such a key."""
    if isinstance(value, dict) and key in value:
        yield value
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from _found(inner, key)


def _answers(faces: Faces, scene_id: str, photos: Sequence[bytes]) -> Iterator[Any]:
    """JSON of photos in a scene, and of all that can be got of it but its versions, which repeat requests."""
    form = [*(("photos", ("a", content)) for content in photos), ("focals", (None, b"420"))]
    yield faces.rest.post(f"/v1/scenes/{scene_id}:localize", files=form).json()
    ids = {"scene_id": scene_id, "format": "camera_list", "observation_id": "none", "operation_id": "none"}
    for name in sorted(CALLS.keys() - {"ListVersions"}):
        method, _, path = CALLS[name].route.partition(" ")
        if method == "GET":
            answer = faces.rest.get(path.format(**ids))
            yield answer.json() if answer.is_success else {}


def test_what_was_seen_stays_true_in_the_frame_of_a_map_which_all_answers_name(
    faces: Faces, client: Client, room_id: str, without: tuple[bytes, ...]
) -> None:
    first = client.scene(room_id).version
    observation = client.observe(room_id, without, focals=(420.0,))
    turn = Pose(Vector3(5.0, 0.0, -1.0), Quaternion(0.0, 0.0, 0.6, 0.8))
    before_map = list(_answers(faces, room_id, without))
    client.align_scene(room_id, Alignment("hall", turn))
    (placed,) = client.observations(room_id)
    before, after = observation.changes[0].before, placed.changes[0].before
    assert before is not None and after is not None
    there = turn.matrix() @ [*before.center.position, 1.0]
    np.testing.assert_allclose(np.array(after.center.position), there[:3], atol=1e-6)
    for left, right in zip(observation.photos, placed.photos, strict=True):
        moved = turn.matrix() @ left.camera.world_from_camera
        np.testing.assert_allclose(right.camera.world_from_camera, moved, atol=1e-6)

    answers = list(_answers(faces, room_id, without))
    for named, frame in ((before_map, "world"), (answers, "hall")):
        frames = [{part["frame_id"] for part in _found(answer, "frame_id")} for answer in named]
        assert [ids for ids in frames if ids] == [{frame}] * 6
    plain = list(_found(answers, "intrinsics"))
    url, body = f"/v1/scenes/{room_id}:query", {"texts": [_CUBE], "cameras": plain, "outputs": ["mask2d"]}
    assert len(faces.rest.post(url, json=body).raise_for_status().json()["answers"][0]["masks"]) == len(plain)
    refused = rest_refusal(faces.rest.post(url, json={**body, "version": first}))  # which is in another frame
    assert (refused.reason, refused.details["field"]) == ("INVALID_INPUT", "cameras[0].frame_id")
    assert "'hall'" in refused.detail and "say world, or" in refused.details["hint"]
    for sent in ("", "world"):
        bodies = [{**body, "cameras": [{**plain[0], "frame_id": frame}]} for frame in (sent, "hall")]
        left, right = (faces.rest.post(url, json=body).raise_for_status().json() for body in bodies)
        assert left == right
    client.align_scene(room_id, Alignment("", turn))
    assert client.detection_page(room_id).frame_id == client.scene(room_id).cameras[0].frame_id == "map"


def test_the_same_request_is_kept_once(client: Client, room_id: str, without: tuple[bytes, ...]) -> None:
    def ask(photos: Sequence[bytes]) -> Observation:
        return client.observe(room_id, photos, focals=(420.0,), request_id="monday")

    observation = ask(without)
    assert ask(without).id == observation.id and len(list(client.observations(room_id))) == 1
    with pytest.raises(ConflictError):
        ask(without[:2])
    client.undo_edit(room_id)
    with pytest.raises(ConflictError, match="was undone"):
        ask(without)


_REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "no photo": ({"photos": ()}, "photos"),
    "one photo with a place": ({"photos": 1}, "photos"),
    "no image": ({"photos": (b"text", PLAIN_PNG)}, "photos[0]"),
    "photos to come": ({"photos": 2, "seen_at": datetime.now(UTC) + timedelta(days=3)}, "seen_at"),
    "a time without a zone": ({"photos": 2, "seen_at": datetime(2026, 3, 2)}, "seen_at"),
    "another name": ({"photos": 2, "request_id": "two words"}, "request_id"),
}


@pytest.mark.parametrize("case", _REFUSED)
def test_what_cannot_be_kept_leaves_nothing(
    faces: Faces, service: SceneService, client: Client, room_id: str, without: tuple[bytes, ...], case: str
) -> None:
    fields, field = _REFUSED[case]
    photos = fields["photos"]
    chosen = {**fields, "photos": (*without[:photos], PLAIN_PNG) if isinstance(photos, int) else photos}
    request = ObserveRequest(scene_id=room_id, focals=(420.0,), **chosen)
    with pytest.raises(InvalidInputError) as caught:
        service.observations.observe(request)
    assert caught.value.field == field
    if "zone" not in case:  # protobuf's times are all in UTC
        with pytest.raises(grpc.RpcError) as over_grpc:
            faces.rpc.ObserveScene(to_proto(request))
        assert rpc_refusal(over_grpc.value).reason == caught.value.reason
    more = {name: chosen[name] for name in ("seen_at", "request_id") if name in chosen}
    with pytest.raises(FastSplatError) as over_rest:
        client.observe(room_id, chosen["photos"], focals=(420.0,), **more)
    assert (over_rest.value.reason, over_rest.value.field) == (caught.value.reason, field)
    assert [version.version for version in client.versions(room_id)] == [client.scene(room_id).version]
    assert _stored_photos(service, room_id) == [] and service._store.blobs.ids("uploads") == ()


def test_there_is_a_most(
    service: SceneService, room_id: str, without: tuple[bytes, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    service.observations.observe(_request(room_id, without))
    monkeypatch.setattr(observing, "MAX_OBSERVATIONS", 1)
    with pytest.raises(LimitExceededError, match="one observation more"):
        service.observations.observe(_request(room_id, without))


def test_nobody_sends_it_as_an_edit(client: Client, room_id: str) -> None:
    with pytest.raises(InvalidInputError, match="an observation is no edit"):
        client.edit_scene(room_id, [Edit("observe")])
