"""Looking again over both protocols, the client and in process: ordered, refused, and told of when it is done."""

from __future__ import annotations

import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.scene.scene_files import read_scene
from fastsplat.service.store.version_repository import NewVersion
from fastsplat_client import Client
from fastsplat_contract.errors import FastSplatError
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.look_again_messages import FoundName, LookAgainResult
from fastsplat_contract.operations import Operation
from fastsplat_contract.proto_codec import from_proto
from fastsplat_contract.scenes import Edit, SceneVersion
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import assert_same
from tests.api.served import Faces
from tests.scenes import write_version


def test_looking_again_is_no_edit(client: Client, own: str) -> None:
    for edit in (Edit("look_again", texts=("trophy",)), Edit("remove", label="mug", texts=("trophy",))):
        with pytest.raises(FastSplatError) as caught:
            client.edit_scene(own, [edit])
        assert caught.value.reason == "INVALID_INPUT" and "LookAgain" in caught.value.hint


def test_what_was_found_is_told_alike(faces: Faces, client: Client, service: SceneService, own: str) -> None:
    """As a worker stores it, once it has succeeded."""
    queued = client.look_again(own, ["trophy"])
    store = service._store
    claim = store.jobs.claim(queued.id)
    assert claim is not None
    before = store.scenes.scene(own)
    folder = store.blobs.version(own, queued.id)
    write_version(read_scene(store.blobs.version(own, before.version) / "artefact"), folder)
    edit = Edit("look_again", texts=("trophy",))
    found = LookAgainResult(
        queued.id,
        ("trophy",),
        ("front.png",),
        True,
        (FoundName(2, "trophy", 0.75),),
        (FoundName(3, "trophy", 0.2),),
        7,
        1,
    )
    new = NewVersion(own, queued.id, before.version, "", "", before.gaussians, before.dictionary, [to_plain(edit)], 0)
    store.jobs.succeed_with_version(claim, new, to_plain(found))
    done = client.wait(queued.id, timeout_s=60)
    assert done.state == "SUCCEEDED" and done.look_again == found
    over_rpc = faces.rpc.GetOperation(pb.GetOperationRequest(operation_id=queued.id))
    assert_same(from_proto(Operation, over_rpc), done)
    versions = faces.rpc.ListVersions(pb.ListVersionsRequest(scene_id=own)).versions
    assert_same(tuple(from_proto(SceneVersion, version) for version in versions), client.versions(own))
    assert client.versions(own)[-1].edits == (edit,) and client.versions(own)[-1].current
    assert client.undo_edit(own).version == before.version
