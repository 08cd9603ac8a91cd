"""What replaces a deprecated call says the same: on a made scene over the network, and on a trained one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import fastsplat
from fastsplat.service.application.service import SceneService
from fastsplat.service.common.dictionary import label_key
from fastsplat_client import Client
from fastsplat_contract import calls
from fastsplat_contract.align_messages import AlignIn
from fastsplat_contract.json_codec import from_json, to_plain
from fastsplat_contract.places import Alignment
from fastsplat_contract.poses import Pose, Quaternion, Vector3
from fastsplat_contract.queries import QueryRequest
from fastsplat_contract.scenes import Edit, SceneObject, SceneVersion
from fastsplat_contract.thing_messages import SceneThing
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.served import Faces
from tests.trained_scenes import trained_tabletop


def test_each_deprecated_call_is_held_against_its_replacement_here() -> None:
    assert {call.rpc for call in calls.CALLS if call.deprecated} == {"ListObjects", "AlignScene", "DownloadMaskPly"}


def assert_views_of_things(objects: Sequence[SceneObject], things: Sequence[SceneThing], labels: Sequence[str]) -> None:
    """Objects say what the things that have a name say, and are all of those."""
    by_id = {thing.id: thing for thing in things if thing.name and thing.box is not None}
    assert sorted(each.thing_id for each in objects) == sorted(by_id)
    assert [each.label_id for each in objects] == sorted(each.label_id for each in objects)
    for each in objects:
        thing = by_id[each.thing_id]
        assert (each.label, each.score, each.box, each.centroid) == (
            thing.name,
            thing.probability,
            thing.box,
            thing.centroid,
        )
        assert (each.gaussian_count, each.meters) == (thing.gaussian_count, thing.meters)
        assert label_key(labels[each.label_id - 1]) == label_key(thing.name)


def test_things_say_what_objects_say(client: Client, own: str) -> None:
    labels = [row.label for row in client.labels(own)]
    for edits in ((), (Edit("name", things=(1,), name="violin"),), (Edit("unname", things=(2,)),)):
        if edits:
            client.edit_scene(own, edits)
            labels = [row.label for row in client.labels(own)]
        objects, things = list(client.objects(own)), list(client.things(own, parts=True))
        assert_views_of_things(objects, things, labels)
        assert objects
        for each in objects:
            best = client.best_views(own, each.thing_id, max_views=5)
            assert {view.view for view in best} == set(each.best_views)
        for label in {each.label for each in objects}:
            (answer,) = client.query(own, label, outputs=["objects"])
            own_things = [thing.id for thing in things if thing.name == label]
            assert sorted(answer.things) == sorted(own_things)
            assert list(client.objects(own, label=label)) == [each for each in objects if each.label == label]


def test_an_edit_aligns_as_its_own_call_does(faces: Faces, service: SceneService, own: str) -> None:
    alignment = Alignment("map", Pose(Vector3(1.0, 2.0, 3.0), Quaternion(0.0, 0.0, 0.6, 0.8)))
    before = service.get_scene(own).version
    made, scenes = [], []
    for path, body in (
        ("align", AlignIn(alignment, "one")),
        ("edit", {"edits": [to_plain(Edit("align", alignment=alignment))], "request_id": "other"}),
    ):
        service.versions.restore(own, before)
        response = faces.rest.post(f"/v1/scenes/{own}:{path}", json=body if isinstance(body, dict) else to_plain(body))
        made.append(from_json(SceneVersion, response.content))
        scenes.append(service.get_scene(own))
        assert ("deprecation" in response.headers) == (path == "align")
    one, other = made
    assert one.version != other.version and (one.edits, one.parent, one.gaussians) == (
        other.edits,
        other.parent,
        other.gaussians,
    )
    assert scenes[0].alignment == scenes[1].alignment and scenes[0].vertical == scenes[1].vertical
    for mine, theirs in zip(scenes[0].cameras, scenes[1].cameras, strict=True):
        np.testing.assert_array_equal(mine.world_from_camera, theirs.world_from_camera)


@pytest.mark.parametrize("text", ["mug", "cup", "elephant"])
def test_a_query_and_an_export_give_the_gaussians_of_an_answer(
    faces: Faces, client: Client, scene_id: str, text: str
) -> None:
    said = faces.rest.get(f"/v1/scenes/{scene_id}/mask.ply", params={"text": text})
    assert said.headers["deprecation"].startswith("@")
    (answer,) = client.query(scene_id, text, outputs=["mask3d", "objects"], mask3d_encoding="ply")
    streamed = faces.rpc.DownloadMaskPly(pb.DownloadMaskPlyRequest(scene_id=scene_id, text=text))
    assert said.content == answer.mask3d == b"".join(chunk.data for chunk in streamed)
    assert said.content == client.mask_ply(scene_id, text)
    if answer.things:
        assert client.export(scene_id, "ply", things=answer.things) == said.content


def test_what_stays_is_not_announced_to_go(faces: Faces, scene_id: str) -> None:
    for path in (f"/v1/scenes/{scene_id}/things", f"/v1/scenes/{scene_id}/labels", f"/v1/scenes/{scene_id}"):
        assert "deprecation" not in faces.rest.get(path).headers
    assert "deprecation" in faces.rest.get(f"/v1/scenes/{scene_id}/objects").headers


def test_the_same_holds_of_a_trained_scene(test_data: Path, models_dir: Path) -> None:
    folder = trained_tabletop(test_data, models_dir) / "scene"
    with fastsplat.open_scene(folder) as scene:
        service = scene._service
        objects = service.answers.list_objects(scene.id, page_size=1_000).objects
        things = service.answers.list_things(scene.id, page_size=1_000, parts=True).things
        labels = [row.label for row in service.list_labels(scene.id, 1_000).labels]
        assert len(objects) > 3
        assert_views_of_things(objects, things, labels)
        for label in sorted({each.label for each in objects})[:3]:
            request = QueryRequest(scene.id, (label,), outputs=frozenset({"mask3d"}), mask3d_encoding="ply")
            (answer,) = service.answers.query(request).answers
            assert answer.mask3d == service.answers.mask_ply(scene.id, label)
