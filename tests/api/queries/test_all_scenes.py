"""A question to all scenes: the newest so many, a damaged one by name and not in the way of the others."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import CallSettings, Settings
from fastsplat_contract.messages.queries import QueryRequest
from tests.api.clients import client_of
from tests.api.made_scene import add_scene
from tests.api.served import Faces, served


@pytest.fixture
def three(api_settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Faces, list[str]]]:
    """A server that asks three scenes at most, and the ids of five, newest first; the second is damaged."""
    settings = api_settings.model_copy(
        update={"data_dir": tmp_path_factory.mktemp("all"), "calls": CallSettings(max_queried_scenes=3)}
    )
    with open_service(settings) as service, served(service, settings) as faces:
        ids = [add_scene(service, settings) for _ in range(5)][::-1]
        _damage(service, ids[1])
        yield faces, ids


def _damage(service: SceneService, scene_id: str) -> None:
    arrays = max(
        (service._store.blobs.version(scene_id, "1") / "artefact").iterdir(), key=lambda path: path.stat().st_size
    )
    content = bytearray(arrays.read_bytes())
    content[-1] ^= 1
    arrays.write_bytes(content)


def test_what_was_not_asked_is_said_by_name(three: tuple[Faces, list[str]]) -> None:
    """Also where nothing but a damaged scene is left."""
    faces, ids = three
    protocols: tuple[Literal["REST", "gRPC"], ...] = ("REST", "gRPC")
    with client_of(faces) as client:
        for protocol in protocols:
            out = client.ask_everywhere(QueryRequest("", ("mug", "ball")), protocol=protocol)
            assert [answer.scene_id for answer in out.answers] == [ids[0], ids[0], ids[2], ids[2]]
            assert [scene.scene_id for scene in out.skipped] == [ids[1], ids[3], ids[4]] and out.skipped_count == 3
            damaged, *over = out.skipped
            assert damaged.reason == "SCENE_DAMAGED" and "digest" in damaged.detail
            assert {scene.reason for scene in over} == {"OVER_LIMIT"}
            assert "FASTSPLAT_CALLS__MAX_QUERIED_SCENES" in over[0].detail
            assert client.ask(QueryRequest("", ("mug", "ball")), protocol=protocol) == out.answers
            alone = client.ask_everywhere(QueryRequest(ids[4], ("mug",)), protocol=protocol)
            assert len(alone.answers) == 1 and (alone.skipped, alone.skipped_count) == ((), 0)
        for scene_id in (ids[0], *ids[2:]):
            client.delete_scene(scene_id)
        for protocol in protocols:
            out = client.ask_everywhere(QueryRequest("", ("mug",)), protocol=protocol)
            assert out.answers == () and [scene.scene_id for scene in out.skipped] == [ids[1]]
