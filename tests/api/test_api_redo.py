"""Redo and restore: the inverse of undo, any version at any time, over both protocols and in process."""

from __future__ import annotations

from dataclasses import replace

import pytest

from fastsplat.service.application.service import SceneService
from fastsplat_client import Client
from fastsplat_contract.errors import ConflictError, InvalidInputError, NotFoundError
from fastsplat_contract.scenes import Edit, SceneVersion


def _named(client: Client, scene_id: str, name: str) -> SceneVersion:
    return client.name_things(scene_id, 1, name, looked_at=client.scene(scene_id).version)


def _name(service: SceneService, scene_id: str) -> str:
    return service.answers.list_things(scene_id).things[0].name


def test_redo_takes_back_undo_step_by_step(service: SceneService, client: Client, own: str) -> None:
    trained = service.versions.resolve(own)
    made = [_named(client, own, name) for name in ("violin", "moon", "carrot")]
    for version in (made[1], made[0]):
        assert client.undo_edit(own).version == version.version
    assert client.undo_edit(own).version == trained
    for version in made:
        redone = client.redo_edit(own)
        assert redone == version and _name(service, own) == version.edits[0].name
        assert client.scene(own).version == version.version
    with pytest.raises(ConflictError):
        client.redo_edit(own)


def test_redo_goes_to_the_version_that_was_left_and_not_to_the_newest(client: Client, own: str) -> None:
    first = _named(client, own, "violin")
    client.undo_edit(own)
    second = _named(client, own, "moon")  # beside the first one, which stays
    client.undo_edit(own)
    assert client.redo_edit(own).version == second.version
    assert client.restore_version(own, first.version).version == first.version
    client.undo_edit(own)
    assert client.redo_edit(own).version == first.version


def test_any_version_is_restored_and_none_is_lost(service: SceneService, client: Client, own: str) -> None:
    trained = client.scene(own)
    assert client.restore_version(own, trained.version).current  # a scene without edits has one version
    first = _named(client, own, "violin")
    client.edit_scene(own, [Edit("remove", things=(2,))])
    before = [version.version for version in client.versions(own)]
    client.restore_version(own, trained.version)
    assert replace(client.scene(own), cameras=()) == replace(trained, cameras=())
    assert client.restore_version(own, first.version, expected=trained.version).version == first.version
    assert [version.version for version in client.versions(own)] == before
    with pytest.raises(ConflictError):
        client.restore_version(own, trained.version, expected=trained.version)
    with pytest.raises(NotFoundError) as missing:
        client.restore_version(own, "e0")
    with pytest.raises(InvalidInputError):
        service.versions.restore(own, "")
    assert missing.value.field == "version" and client.scene(own).version == first.version


def test_a_redo_that_is_repeated_redoes_once(client: Client, own: str) -> None:
    made = [_named(client, own, name) for name in ("violin", "moon")]
    client.restore_version(own, made[0].parent)
    assert client.redo_edit(own, made[0].parent).version == made[0].version
    with pytest.raises(ConflictError) as caught:
        client.redo_edit(own, made[0].parent)
    assert caught.value.field == "version"
