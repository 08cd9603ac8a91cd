"""Edits make versions: shown at once, undone at once, and nobody's question fails meanwhile."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat_client import Client
from fastsplat_contract.codec.proto_codec import to_proto
from fastsplat_contract.errors import ConflictError
from fastsplat_contract.geometry.poses import Pose
from fastsplat_contract.messages.objects import SceneObject
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.messages.scenes import Edit, SceneUpdate
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.served import Faces
from tests.at_once import at_once

_REMOVE = Edit("remove", label="mug")
_UP = Pose((0.0, -1.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def test_an_edit_is_a_new_version_that_can_be_undone(faces: Faces, client: Client, fresh_id: str) -> None:
    before = client.scene(fresh_id)
    (answer,) = client.query(fresh_id, "mug", outputs=["mask3d", "objects"])
    removal = client.edit_scene(fresh_id, [_REMOVE])
    assert (removal.parent, removal.current, removal.edits) == (before.version, True, (_REMOVE,))
    after = client.scene(fresh_id)
    mugs = answer.matches[0].gaussian_count
    assert after.version == removal.version and after.gaussians == removal.gaussians == before.gaussians - mugs
    assert [row.gaussian_count for row in after.dictionary] == [0, 60, 60]
    assert not client.mask3d(fresh_id, "mug").any() and len(client.mask3d(fresh_id, "ball")) == after.gaussians
    assert [obj.name for obj in client.objects(fresh_id)] != [obj.name for obj in client.objects(fresh_id, version="1")]

    # The old version answers as before, whoever asks for it by name.
    (old,) = client.query(fresh_id, "mug", outputs=["mask3d", "objects"], version=before.version)
    assert old == answer
    assert [(v.version, v.current) for v in client.versions(fresh_id)] == [
        (before.version, False),
        (removal.version, True),
    ]

    undone = client.undo_edit(fresh_id, removal.version)
    assert (undone.version, undone.current) == (before.version, True)
    assert client.query(fresh_id, "mug", outputs=["mask3d", "objects"]) == (answer,)
    assert replace(client.scene(fresh_id), cameras=()) == replace(before, cameras=())
    listed = faces.rpc.ListVersions(pb.ListVersionsRequest(scene_id=fresh_id)).versions
    assert list(listed) == [to_proto(version) for version in client.versions(fresh_id)]


def _mugs(client: Client, scene_id: str) -> list[SceneObject]:
    return [obj for obj in client.objects(scene_id) if obj.name == "mug"]


def test_edits_of_one_request_build_on_each_other(client: Client, fresh_id: str) -> None:
    (mug,) = _mugs(client, fresh_id)
    version = client.edit_scene(
        fresh_id,
        [Edit("recolor", object_ids=(mug.id,), color=(0.0, 0.0, 1.0)), Edit("move", label="mug", transform=_UP)],
    )
    (moved,) = _mugs(client, fresh_id)
    # Within a hundredth: what was a label's object is an object from then on, with the faint Gaussians around it.
    np.testing.assert_allclose(moved.centroid, np.add(mug.centroid, _UP.position), atol=0.01)
    assert (client.depth(fresh_id, "front.png") != client.depth(fresh_id, "front.png", version=version.parent)).any()
    copies = client.edit_scene(fresh_id, [Edit("duplicate", label="mug", transform=_UP)])
    assert copies.gaussians == version.gaussians + 60  # those too faint for the object, too
    assert len(_mugs(client, fresh_id)) == 2
    assert client.undo_edit(fresh_id).version == version.version
    assert client.undo_edit(fresh_id).version == version.parent
    with pytest.raises(ConflictError):
        client.undo_edit(fresh_id)


def test_no_question_fails_while_versions_come_and_go(service: SceneService, client: Client, fresh_id: str) -> None:
    over = threading.Event()
    sizes: set[int] = set()

    def ask(number: int) -> int:
        count = 0
        while not over.is_set():
            (answer,) = service.answers.query(QueryRequest(fresh_id, ("mug",), outputs=frozenset({"mask3d"}))).answers
            assert len(answer.mask3d) == -(-answer.gaussians // 8)
            client.query(fresh_id, "mug", views=["front.png"], outputs=["mask2d"])
            sizes.add(answer.gaussians)
            count += 1
        return count

    with ThreadPoolExecutor(4) as pool:
        readers = [pool.submit(ask, number) for number in range(4)]
        try:
            for _ in range(4):
                version = client.edit_scene(fresh_id, [_REMOVE])
                client.edit_scene(fresh_id, [Edit("duplicate", label="ball", transform=_UP)])
                client.undo_edit(fresh_id)
                assert client.undo_edit(fresh_id).version == version.parent
        finally:
            over.set()
        assert all(reader.result() > 0 for reader in readers)
    assert sizes >= {240, 180}


def test_of_two_at_once_that_expect_the_same_name_one_wins(service: SceneService, fresh_id: str) -> None:
    updates = (SceneUpdate(name, "to change") for name in ("one", "two"))
    outcomes = at_once(*(partial(service.update_scene, fresh_id, update) for update in updates))
    (winner,) = (renamed for renamed in outcomes if not isinstance(renamed, ConflictError))
    assert service.get_scene(fresh_id).name == winner.name != "to change"
