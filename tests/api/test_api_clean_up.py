"""Clean up and crop over the API and by the command: a preview changes nothing, what it tells goes, undo restores it
bit by bit, and things keep ids and names."""

from __future__ import annotations

import numpy as np
import pytest

from fastsplat_client import Client
from fastsplat_contract.errors import ConflictError
from fastsplat_contract.gaussian_filters import GaussianFilter
from fastsplat_contract.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.scenes import Edit

_UPRIGHT = Quaternion(0.0, 0.0, 0.0, 1.0)


def _around(client: Client, scene_id: str, label: str) -> Box:
    """A box with all of a label's Gaussians in it, half a unit larger each way."""
    (thing,) = client.query(scene_id, label, outputs=["objects"])[0].objects
    size = np.array(thing.box.size)
    return Box(Pose(thing.box.center.position, _UPRIGHT), Vector3(*(np.full(3, np.linalg.norm(size)) + 0.5).tolist()))


def test_what_a_preview_tells_goes_and_undo_restores_it_bit_by_bit(client: Client, own: str) -> None:
    client.name_things(own, [thing.id for thing in client.things(own)][:1], "violin")
    before, file = client.scene(own), client.export(own, "ply")
    owners = client.thing_ids(own)
    edits = [
        Edit("remove", filter=GaussianFilter(box=_around(client, own, "ball"), outside=True)),
        Edit("remove", filter=GaussianFilter(isolation_above=1.3)),
    ]
    told = client.preview_edit(own, edits)
    assert client.scene(own).version == before.version == told.version
    assert 0 < told.count == sum(told.counts) == told.array().sum() < told.gaussians == before.gaussians
    made = client.edit_scene(own, edits)
    assert made.gaussians == before.gaussians - told.count and made.edits == tuple(edits)
    np.testing.assert_array_equal(client.thing_ids(own), owners[~told.array()])
    left = {thing.id: thing.name for thing in client.things(own)}
    assert left.items() <= {thing.id: thing.name for thing in client.things(own, version=before.version)}.items()
    assert client.preview_edit(own, edits, version=before.version) == told  # of the version that was looked at
    assert client.undo_edit(own, made.version).version == before.version
    assert client.export(own, "ply") == file
    np.testing.assert_array_equal(client.thing_ids(own), owners)
    with pytest.raises(ConflictError):
        client.undo_edit(own, made.version)
