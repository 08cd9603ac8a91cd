"""Edits make versions: shown at once, undone at once, and nobody's question fails meanwhile."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_contract.codec.proto_codec import to_proto
from fastsplat_contract.errors import ConflictError
from fastsplat_contract.geometry.poses import Pose
from fastsplat_contract.messages.objects import SceneObject
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.messages.scenes import Edit, SceneUpdate
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.made_scene import add_scene
from tests.api.served import Faces

_REMOVE = Edit("remove", label="mug")
_UP = Pose((0.0, -1.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def test_an_edit_is_a_new_version_that_can_be_undone(faces: Faces, client: Client, own: str) -> None:
    before = client.scene(own)
    (answer,) = client.query(own, "mug", outputs=["mask3d", "objects"])
    made = client.edit_scene(own, [_REMOVE])
    assert (made.parent, made.current, made.edits) == (before.version, True, (_REMOVE,))
    after = client.scene(own)
    mugs = answer.matches[0].gaussian_count
    assert after.version == made.version and after.gaussians == made.gaussians == before.gaussians - mugs
    assert [row.gaussian_count for row in after.dictionary] == [0, 60, 60]
    assert not client.mask3d(own, "mug").any() and len(client.mask3d(own, "ball")) == after.gaussians
    assert [obj.name for obj in client.objects(own)] != [obj.name for obj in client.objects(own, version="1")]

    # The old version answers as before, whoever asks for it by name.
    (old,) = client.query(own, "mug", outputs=["mask3d", "objects"], version=before.version)
    assert old == answer
    assert [(v.version, v.current) for v in client.versions(own)] == [(before.version, False), (made.version, True)]

    undone = client.undo_edit(own, made.version)
    assert (undone.version, undone.current) == (before.version, True)
    assert client.query(own, "mug", outputs=["mask3d", "objects"]) == (answer,)
    assert replace(client.scene(own), cameras=()) == replace(before, cameras=())
    listed = faces.rpc.ListVersions(pb.ListVersionsRequest(scene_id=own)).versions
    assert list(listed) == [to_proto(version) for version in client.versions(own)]


def _mugs(client: Client, scene_id: str) -> list[SceneObject]:
    return [obj for obj in client.objects(scene_id) if obj.name == "mug"]


def test_edits_of_one_request_build_on_each_other(client: Client, own: str) -> None:
    (mug,) = _mugs(client, own)
    made = client.edit_scene(
        own,
        [Edit("recolor", object_ids=(mug.id,), color=(0.0, 0.0, 1.0)), Edit("move", label="mug", transform=_UP)],
    )
    (moved,) = _mugs(client, own)
    # Within a hundredth: what was a label's object is an object from then on, with the faint Gaussians around it.
    np.testing.assert_allclose(moved.centroid, np.add(mug.centroid, _UP.position), atol=0.01)
    assert (client.depth(own, "front.png") != client.depth(own, "front.png", version=made.parent)).any()
    copies = client.edit_scene(own, [Edit("duplicate", label="mug", transform=_UP)])
    assert copies.gaussians == made.gaussians + 60  # those too faint for the object, too
    assert len(_mugs(client, own)) == 2
    assert client.undo_edit(own).version == made.version
    assert client.undo_edit(own).version == made.parent
    with pytest.raises(ConflictError):
        client.undo_edit(own)


def test_no_question_fails_while_versions_come_and_go(service: SceneService, client: Client, own: str) -> None:
    over = threading.Event()
    sizes: set[int] = set()

    def ask(number: int) -> int:
        asked = 0
        while not over.is_set():
            (answer,) = service.answers.query(QueryRequest(own, ("mug",), outputs=frozenset({"mask3d"}))).answers
            assert len(answer.mask3d) == -(-answer.gaussians // 8)
            client.query(own, "mug", views=["front.png"], outputs=["mask2d"])
            sizes.add(answer.gaussians)
            asked += 1
        return asked

    with ThreadPoolExecutor(4) as pool:
        readers = [pool.submit(ask, number) for number in range(4)]
        try:
            for _ in range(4):
                made = client.edit_scene(own, [_REMOVE])
                client.edit_scene(own, [Edit("duplicate", label="ball", transform=_UP)])
                client.undo_edit(own)
                assert client.undo_edit(own).version == made.parent
        finally:
            over.set()
        assert all(reader.result() > 0 for reader in readers)
    assert sizes >= {240, 180}


@pytest.fixture
def scene(service: SceneService, api_settings: Settings) -> str:
    """A scene of one test, which the server of all tests keeps."""
    return add_scene(service, api_settings, "made")


def test_of_two_at_once_that_expect_the_same_name_one_wins(service: SceneService, scene: str) -> None:
    outcomes: list[str] = []
    start = threading.Barrier(2)

    def rename(name: str) -> None:
        start.wait()
        try:
            outcomes.append(service.update_scene(scene, SceneUpdate(name, "made")).name)
        except ConflictError:
            outcomes.append("")

    threads = [threading.Thread(target=rename, args=(name,)) for name in ("one", "two")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(outcomes)[0] == "" and outcomes.count("") == 1
    assert service.get_scene(scene).name in outcomes
    service.delete_scene(scene)
