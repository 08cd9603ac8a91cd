"""Captures of one place: listed by date, and asked as one, the newest that saw the spot; nobody else's among them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from fastsplat.cli.main import app
from fastsplat.service.application.answering.captures import Captures
from fastsplat.service.application.service import SceneService
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.query.language.query_text import TextQuery
from fastsplat.service.query.settings import QuerySettings
from fastsplat.service.scene.types import TAKEN_AT, Scene
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_contract.errors import FastSplatError, InvalidInputError, NotFoundError, NotReadyError
from fastsplat_contract.places import Alignment
from fastsplat_contract.poses import Pose, Quaternion, Vector3, look_at
from fastsplat_contract.proto_codec import from_proto, to_proto
from fastsplat_contract.queries import Answer, QueryRequest
from fastsplat_contract.requests import ListScenesRequest
from fastsplat_contract.scenes import Edit, SceneList
from tests.api.made_scene import ENCODER, LABELS
from tests.api.served import Faces
from tests.localization.textured_room import textured_room
from tests.scenes import finish_job, queued_job

_CUBE = "elephant"
_MARCH = datetime(2026, 3, 1, 18, tzinfo=UTC)
_SAME = Pose(Vector3(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))

Add = Callable[..., str]


def _room(settings: Settings, day: int | None, cube: str, moved: float, seen: bool) -> Scene:
    encoder = open_text_encoder(ENCODER, settings.models)
    taken = [_MARCH + timedelta(days) for days in ((day or 0) - 1, (day or 0) - 40)]  # the newest photo counts
    times = {} if day is None else {TAKEN_AT: {f"{n}.png": each.timestamp() for n, each in enumerate(taken)}}
    labels = (*LABELS, cube or _CUBE)
    made = textured_room(
        block=bool(cube),
        labels=labels,
        encoder=encoder,
        templates=QuerySettings().templates,
        scale="METRIC",
        quality={"images": 8, **times},
    )
    walls = len(textured_room().gaussians.means)
    means = made.gaussians.means.copy()
    means[walls:] += np.array([moved, 0.0, 0.0], np.float32)
    cameras = made.cameras
    if not seen:  # above the cube
        places = (each.world_from_camera[:3, 3] for each in cameras)
        cameras = tuple(
            replace(each, world_from_camera=look_at(at, at * [0.2, 0.2, 1.0] + [0.0, 0.0, 3.0]))
            for each, at in zip(cameras, places, strict=True)
        )
    return replace(made, gaussians=replace(made.gaussians, means=means), cameras=cameras)


@pytest.fixture
def add(service: SceneService, api_settings: Settings) -> Iterator[Add]:
    """Adds a capture of the room of a day of March, in which a cube of this name stands, so far from where it stood
    first; in the frame of another scene, or in one of its own."""
    made: list[tuple[SceneService, str]] = []

    def adding(
        day: int | None = 1, cube: str = _CUBE, *, moved: float = 0.0, seen: bool = True, frame: str = "", **of: Any
    ) -> str:
        place = service.in_project(of.get("project", service.project))
        job = replace(queued_job(f"of {day} March"), project=place.project)
        place._store.scenes.create(job)
        finish_job(place._store, job.operation_id, _room(api_settings, day, cube, moved, seen))
        if frame:
            place.versions.edit(job.scene_id, (Edit("align", alignment=Alignment(frame, transform=_SAME)),))
        made.append((place, job.scene_id))
        return job.scene_id

    yield adding
    for place, scene_id in made:
        if any(each.id == scene_id for each in place.list_scenes(500).scenes):
            place.delete_scene(scene_id)


def _ask(client: Client, scene_id: str, **choices: Any) -> Any:
    (answer,) = client.query(scene_id, _CUBE, outputs=["objects"], newest_capture=True, **choices)
    return answer


def test_what_moved_is_answered_by_the_newer_capture(client: Client, add: Add) -> None:
    old = add(1)
    new = add(3, moved=0.5, frame=old)
    alone = client.query(old, _CUBE)[0]
    for asked in (old, new):
        answer = _ask(client, asked)
        assert (answer.scene_id, answer.outcome) == (new, "here")
        assert answer.sentence == f"By the capture of 3 March 2026: {alone.sentence}"
        (thing,) = answer.objects
        assert thing.centroid.x == pytest.approx(0.8 + 0.5 + 0.225, abs=0.05)
    assert client.query(old, _CUBE)[0] == alone, "asked alone, a capture answers as before"


def test_what_the_newer_one_did_not_see_is_answered_by_the_older_which_says_so(client: Client, add: Add) -> None:
    old = add(1)
    add(3, cube="", seen=False, frame=old)
    answer = _ask(client, old)
    assert (answer.scene_id, answer.outcome) == (old, "here") and answer.objects
    assert answer.sentence.startswith("By the capture of 1 March 2026, as no later one saw its place: Here")


def test_where_the_newer_one_saw_an_empty_place_it_is_not_here_any_more(client: Client, add: Add) -> None:
    old = add(1)
    seeing = add(3, cube="", frame=old)
    add(5, cube="", seen=False, frame=old)
    answer = _ask(client, old)
    assert (answer.scene_id, answer.outcome, answer.objects) == (seeing, "not_here", ())
    told = (
        "Not here any more: the capture of 3 March 2026 saw its place, which is empty. By the capture of 1 March 2026"
    )
    assert answer.sentence.startswith(told)


def test_what_has_another_name_in_the_newer_one_is_answered_by_the_older_which_says_so(
    client: Client, add: Add
) -> None:
    old = add(1)
    add(3, cube="volcano", frame=old)
    answer = _ask(client, old)
    assert (answer.scene_id, answer.outcome) == (old, "here")
    assert "; that of 3 March 2026 has something in its place that has no such name: " in answer.sentence


def test_what_no_capture_shows_is_answered_by_the_newest(client: Client, add: Add) -> None:
    old = add(1, cube="")
    new = add(3, cube="", frame=old)
    answer = _ask(client, old)
    assert (answer.scene_id, answer.outcome, answer.objects) == (new, "not_here", ())
    assert answer.sentence.startswith("By the capture of 3 March 2026: Not here")


def test_captures_are_listed_by_the_days_of_their_photos_over_every_face(
    faces: Faces, client: Client, add: Add
) -> None:
    first = add(2)
    later, before, other = add(4, frame=first), add(1, frame=first), add(3)
    third = add(3, frame=first)
    undated = add(None, frame=first)
    expected = [undated, later, third, first, before]  # that which says no day was posted now
    for place in (first, third):
        assert [each.id for each in client.scenes(place=place)] == expected
    assert [each.captured_at for each in client.scenes(place=other)] == [_MARCH + timedelta(2)]
    request = to_proto(ListScenesRequest(page_size=2, place=later))
    page = from_proto(SceneList, faces.rpc.ListScenes(request))
    assert [each.id for each in page.scenes] == expected[:2] and page.scenes[0].captured_at is None
    rest = faces.rest.get("/v1/scenes", params={"place": later, "page_size": 2, "page_token": page.next_page_token})
    assert [each["id"] for each in rest.json()["scenes"]] == expected[2:4]
    words = ["--server", str(faces.rest.base_url)]
    listed = CliRunner().invoke(app, ["scenes", "list", "--place", first, *words]).stdout
    assert listed.index(later[:8]) < listed.index(first[:8]) and "2026-03-04" in listed and other[:8] not in listed
    asked = CliRunner().invoke(app, ["ask", first, _CUBE, "--newest-capture", *words]).stdout
    assert asked.startswith(f"By the capture of {datetime.now(UTC).day} ")
    got = faces.rest.get("/query", params={"text": _CUBE, "scene": first, "newest_capture": True}).json()
    assert [each["scene_id"] for each in got["answers"]] == [undated]
    over_grpc = client.ask_everywhere(QueryRequest(first, (_CUBE,), newest_capture=True), protocol="gRPC")
    assert [each.scene_id for each in over_grpc.answers] == [undated]


def test_captures_of_one_day_are_told_apart_by_the_time(client: Client, add: Add, service: SceneService) -> None:
    old = add(1)
    add(1, moved=0.5, frame=old)
    assert _ask(client, old).sentence.startswith("By the capture of 1 March 2026, 18:00 UTC: ")


def test_a_capture_that_leaves_the_frame_or_is_deleted_does_not_answer(
    service: SceneService, client: Client, add: Add
) -> None:
    old = add(1)
    new, newest = add(3, moved=0.5, frame=old), add(5, moved=0.3, frame=old)
    assert _ask(client, old).scene_id == newest
    client.undo_edit(newest)
    assert _ask(client, old).scene_id == new
    service.delete_scene(new)
    assert _ask(client, old).scene_id == old and [each.id for each in client.scenes(place=old)] == [old]


def test_scenes_in_different_frames_are_refused(client: Client, add: Add) -> None:
    old = add(1)
    new = add(3, frame=old)
    client.align_scene(old, Alignment("robot_map", transform=_SAME))
    calls: list[Callable[[], object]] = [lambda: list(client.scenes(place=new)), lambda: _ask(client, new)]
    for call in calls:
        with pytest.raises(NotReadyError, match=f"{old}.*to which scene .{new}. was aligned"):
            call()
    assert _ask(client, old).scene_id == old, "it is in the map's frame with itself"
    client.align_scene(new, Alignment("robot_map", transform=_SAME))
    assert [each.id for each in client.scenes(place=old)] == [new, old]


def test_what_belongs_to_one_capture_is_refused(client: Client, add: Add) -> None:
    scene = add(1)
    cases: list[tuple[dict[str, Any], str, type[FastSplatError], str]] = [
        ({"views": ("0.png",)}, scene, InvalidInputError, "views"),
        ({"asker_view": "0.png"}, scene, InvalidInputError, "asker_view"),
        ({"version": client.scene(scene).version}, scene, InvalidInputError, "version"),
        ({}, "", InvalidInputError, "scene_id"),
        ({}, "0" * 32, NotFoundError, "scene"),
    ]
    for choices, asked, error, field in cases:
        with pytest.raises(error) as caught:
            _ask(client, asked, **choices)
        assert caught.value.field == field
    with pytest.raises(NotFoundError):
        list(client.scenes(place="0" * 32))


def test_captures_of_another_project_are_not_there(service: SceneService, client: Client, add: Add) -> None:
    service.admin.projects.create("next-place")
    mine = add(1)
    theirs = add(5, moved=0.5, frame=mine, project="next-place")
    assert [each.id for each in client.scenes(place=mine)] == [mine]
    assert _ask(client, mine).scene_id == mine
    with pytest.raises(NotFoundError):
        list(client.scenes(place=theirs))
    next_door = service.in_project("next-place")
    assert [each.id for each in next_door.list_scenes(place=theirs).scenes] == [theirs]


def test_who_may_see_one_scene_sees_no_other_capture(service: SceneService, add: Add) -> None:
    old = add(1)
    new = add(3, moved=0.5, frame=old)
    shared = service.in_project(service.project, new)
    assert [each.id for each in shared.list_scenes(place=new).scenes] == [new]
    asked = QueryRequest(old, (_CUBE,), newest_capture=True)
    with pytest.raises(NotFoundError):
        shared.answers.query(asked)
    shared = service.in_project(service.project, old)
    assert [each.scene_id for each in shared.answers.query(asked).answers] == [old]


def test_what_is_not_here_any_more_stays_so_with_all_outputs(service: SceneService, add: Add) -> None:
    """Also where the capture that saw the empty place cannot say whether there is another one."""
    old = add(1)
    new = add(3, cube="", frame=old)
    answers = service.answers
    captures = answers.captures

    def unsure(query: TextQuery, request: QueryRequest) -> tuple[Answer, ...]:
        told = answers.query(replace(request, newest_capture=False)).answers
        return tuple(replace(each, outcome="cannot_say") if each.scene_id == new else each for each in told)

    asking = Captures(captures._store, captures._scenes, captures._all_scenes, unsure)
    request = QueryRequest(old, (_CUBE,), newest_capture=True, outputs=frozenset({"objects"}))
    (told,) = asking.query(answers._check(request), request).answers
    assert (told.scene_id, told.outcome) == (new, "not_here") and told.sentence.startswith("Not here any more")


def test_where_the_asker_stands_counts_in_every_capture(client: Client, add: Add) -> None:
    """Seen from the room the left wall, called "mug", is left of the back wall, called "ball", but not from behind."""
    old = add(1)
    new = add(3, moved=0.5, frame=old)
    outcomes = []
    for at in ((0.9, -3.0, 1.0), (0.9, 5.0, 1.0)):
        turn = Rotation.from_matrix(look_at(at, (0.9, 1.0, 0.5))[:3, :3]).as_quat()
        asker = Pose(Vector3(*at), Quaternion(*turn))
        (alone,) = client.query(new, "mug left of the ball", asker=asker)
        (told,) = client.query(old, "mug left of the ball", asker=asker, newest_capture=True)
        assert told.sentence == f"By the capture of 3 March 2026: {alone.sentence}"
        outcomes.append(told.outcome)
    assert outcomes == ["here", "not_here"]
