"""Objects over both protocols and in process: listed, picked, named, and asked for by their names."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_contract.errors import ConflictError, FastSplatError, NotFoundError
from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3
from fastsplat_contract.masks import decode_mask3d
from fastsplat_contract.messages.objects import PickRequest, Pixel, PixelBox
from fastsplat_contract.messages.scenes import Edit, InsertSource
from tests.api.clients import assert_same
from tests.api.made_scene import ENCODER, made_scene, parted_scene, turned
from tests.api.served import Faces, rest_refusal
from tests.at_once import at_once
from tests.scenes import store_scene

_WORDS = ("moon", "violin", "carrot", "volcano")  # the tests' encoder knows few


def test_picks_show_the_mask_of_what_is_asked_for_by_name(client: Client, service: SceneService, scene_id: str) -> None:
    (answer,) = client.query(scene_id, "ball", views=["front.png"], outputs=["mask2d"])
    mask = answer.masks[0].array()
    rows, columns = np.nonzero(mask)
    middle = Pixel(float(np.median(columns)) + 0.5, float(np.median(rows)) + 0.5)
    box = PixelBox(float(columns.min()), float(rows.min()), columns.max() + 1.0, rows.max() + 1.0)
    ball = list(client.objects(scene_id))[1]
    assert ball.box is not None
    requests = [
        PickRequest(scene_id, view="front.png", pixel=middle),
        PickRequest(scene_id, view="front.png", pixel=middle, mask2d_encoding="png"),
        PickRequest(scene_id, view="front.png", box=box, version="1"),
        PickRequest(scene_id, camera=turned(0.0), pixel=middle),
        PickRequest(scene_id, point=ball.box.center.position),
        PickRequest(scene_id, point=ball.box.center.position, camera=turned(0.0)),
    ]
    for request in requests:
        picked = service.answers.pick(request)
        assert picked.object.name == "ball" and picked.version == "1"
        assert (picked.mask is not None) == (request.view is not None or request.camera is not None)
        if picked.mask is not None:
            assert (picked.mask.array() ^ mask).sum() <= 0.1 * mask.sum()
    assert_same(client.pick(scene_id, "front.png", pixel=middle), service.answers.pick(requests[0]))
    assert_same(client.pick(scene_id, turned(0.0), box=box).object, ball)
    assert_same(client.pick(scene_id, point=ball.box.center.position).object, ball)


def test_two_places_at_once_are_refused(faces: Faces, scene_id: str) -> None:
    both = {"view": "front.png", "pixel": {"x": 24.0, "y": 18.0}, "point": {"x": 0.0, "y": 0.0, "z": 4.0}}
    assert rest_refusal(faces.rest.post(f"/v1/scenes/{scene_id}:pick", json=both)).details["field"] == "point"


def test_a_name_is_asked_for_and_masked_by_every_call_until_it_is_undone(
    client: Client, service: SceneService, fresh_id: str
) -> None:
    before = client.scene(fresh_id)
    mug = client.pick(fresh_id, "front.png", pixel=(15.5, 18.5))
    assert mug.object.name == "mug" and mug.mask is not None
    version = client.name_objects(
        fresh_id, mug.object.id, "violin", aliases=["elephant", "moon"], looked_at=mug.version
    )
    named = Edit("name", object_ids=(mug.object.id,), name="violin", aliases=("elephant", "moon"))
    assert version.edits == (named,) and version.current
    for text in ("violin", "elephant", "moon"):
        (answer,) = client.query(fresh_id, text, views=["front.png"], outputs=["mask2d", "mask3d", "objects"])
        assert (answer.outcome, answer.object_ids, answer.version) == ("here", (mug.object.id,), version.version)
        np.testing.assert_array_equal(
            answer.masks[0].array(), client.pick(fresh_id, "front.png", pixel=(15.5, 18.5)).mask.array()
        )
        assert [item.name for item in answer.objects or ()] == ["violin"]
    assert client.mask3d(fresh_id, "elephant").sum() > 40
    named = next(client.objects(fresh_id))
    assert (named.id, named.name, named.source, named.probability) == (mug.object.id, "violin", "person", 1)
    assert (client.object_ids(fresh_id) == named.id).sum() == named.gaussian_count
    labels = {row.label: (row.gaussian_count, row.aliases) for row in client.labels(fresh_id)}
    assert labels["mug"][0] == 0 and labels["violin"] == (named.gaussian_count, ("elephant", "moon"))
    assert client.query(fresh_id, "mug")[0].is_absent
    assert (client.label_map(fresh_id, "front.png") == 4).sum() == mug.mask.area

    # Another service on the same data reads what was written.
    service._context.scenes.forget(fresh_id)
    assert client.query(fresh_id, "elephant")[0].object_ids == (mug.object.id,)
    client.undo_edit(fresh_id, version.version)
    assert replace(client.scene(fresh_id), cameras=()) == replace(before, cameras=())
    assert client.query(fresh_id, "mug")[0].outcome == "here" and client.query(fresh_id, "elephant")[0].is_absent


def test_two_people_who_name_at_once_are_both_kept_or_one_is_told(client: Client, fresh_id: str) -> None:
    def name(object_id: int, word: str, looked_at: str) -> Callable[[], Any]:
        return lambda: client.name_objects(fresh_id, object_id, word, looked_at=looked_at)

    different = at_once(*(name(object_id, _WORDS[object_id], "1") for object_id in (1, 2, 3)))
    assert not [outcome for outcome in different if isinstance(outcome, FastSplatError)]
    assert [obj.name for obj in client.objects(fresh_id)] == list(_WORDS[1:])
    version = client.scene(fresh_id).version
    same = at_once(*(name(2, word, version) for word in ("sphere", "balloon", "novel")))
    conflicts = [outcome for outcome in same if isinstance(outcome, ConflictError)]
    assert len(conflicts) == 2 and all(error.field == "edits[0].version" for error in conflicts)
    (winner,) = (outcome for outcome in same if not isinstance(outcome, FastSplatError))
    assert list(client.objects(fresh_id))[1].name == winner.edits[0].name
    with pytest.raises(ConflictError):
        client.name_objects(fresh_id, 2, "paperback")
    assert client.name_objects(fresh_id, 2, "paperback", looked_at=winner.version).current
    with pytest.raises(NotFoundError):
        client.name_objects(fresh_id, 2, "paperback", looked_at="e0")


def test_objects_of_another_project_are_not_inserted(
    service: SceneService, api_settings: Settings, fresh_id: str
) -> None:
    service.admin.projects.create("next-door")
    up = Pose(Vector3(0.0, -1.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
    foreign = service.in_project("next-door")
    encoder = open_text_encoder(ENCODER, api_settings.models)
    own_id = store_scene(foreign._store, made_scene(encoder), project="next-door")
    edit = Edit("insert", object_ids=(1,), transform=up, source=InsertSource(fresh_id))
    with pytest.raises(NotFoundError) as raised:
        foreign.versions.edit(own_id, [edit])
    assert raised.value.field == "edits[0].source.scene"
    foreign.delete_scene(own_id)


@pytest.fixture
def with_part(service: SceneService, api_settings: Settings) -> Iterator[str]:
    scene_id = store_scene(service._store, parted_scene(open_text_encoder(ENCODER, api_settings.models)), "parts")
    yield scene_id
    service.delete_scene(scene_id)


def test_parts_are_listed_picked_and_named_alike(client: Client, service: SceneService, with_part: str) -> None:
    assert [(obj.id, obj.parts) for obj in client.objects(with_part)] == [(1, (4,)), (2, ()), (3, ())]
    truth = service.answers.list_objects(with_part, parts=True)
    assert [(obj.id, obj.kind, obj.parent) for obj in truth.objects][:2] == [(1, "object", 0), (4, "part", 1)]
    assert_same(tuple(client.objects(with_part, parts=True)), truth.objects)
    part = truth.objects[1]
    assert part.box is not None
    pick = PickRequest(with_part, point=part.box.center.position, view="front.png")
    picked = service.answers.pick(pick)
    assert picked.object.id == 1 and picked.part == part
    assert picked.mask is not None
    rows, columns = np.nonzero(picked.mask.array())
    by_pixel = {
        client.pick(with_part, "front.png", pixel=(column + 0.5, row + 0.5)).part
        for row, column in zip(rows, columns, strict=True)
    }
    assert by_pixel == {None, part}
    for level, ids in (("part", (4,)), ("object", (1,)), ("group", (1, 2))):
        request = replace(pick, level=level, mask3d=True)
        by_level = service.answers.pick(request)
        assert_same(
            client.pick(with_part, point=part.box.center.position, level=level, mask3d=True),
            replace(by_level, mask=None),
        )
        assert by_level.level == level and [choice.level for choice in by_level.levels] == ["part", "object", "group"]
        assert sum(choice.probability for choice in by_level.levels) == pytest.approx(1)
        owner = client.object_ids(with_part)
        inside = decode_mask3d(by_level.mask3d or b"", "bits", len(owner))
        assert inside.sum() == sum(obj.gaussian_count for obj in truth.objects if obj.id in ids)
        assert by_level.mask is not None and by_level.mask.area > 0
        alone = client.export(with_part, "ply", objects=[by_level.picked.id])
        assert f"element vertex {inside.sum()}\n".encode() in alone
    client.name_objects(with_part, 4, "moon")
    (answer,) = client.query(with_part, "moon", views=["front.png"], outputs=["mask2d", "objects"])
    assert answer.outcome == "here" and answer.object_ids == (4,) and (answer.objects or ())[0].id == 4
    inside = answer.masks[0].array()
    assert 0 < (inside & picked.mask.array()).sum() < picked.mask.array().sum()
    rows_of_labels = {row.label: row.gaussian_count for row in service.get_scene(with_part).dictionary}
    assert rows_of_labels["moon"] == part.gaussian_count and rows_of_labels["mug"] == truth.objects[0].gaussian_count
    client.undo_edit(with_part)
    assert_same(tuple(client.objects(with_part, parts=True)), truth.objects)
