"""The sample scene that the server brings, copied into a project over every face."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import QuotaSettings, Settings
from fastsplat.service.store.store import open_store
from fastsplat_contract.errors import QuotaError
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import client_of
from tests.api.served import Faces
from tests.at_once import at_once


@pytest.fixture
def empty_service(tmp_path: Path) -> Iterator[SceneService]:
    """A service without scenes."""
    settings = Settings(data_dir=tmp_path)
    with SceneService(open_store(tmp_path), settings) as service:
        yield service


def _folders(root: Path) -> list[str]:
    return sorted(path.name for kind in ("scenes", "uploads") for path in (root / kind).glob("*"))


def test_each_face_opens_the_one_sample_of_the_project(faces: Faces, service: SceneService) -> None:
    with client_of(faces) as client:
        opened = client.open_sample()
        try:
            assert opened.state == "READY" and opened.name == "A table (sample)" and opened.scale == "METRIC"
            assert faces.rpc.OpenSample(pb.OpenSampleRequest()).id == service.open_sample().id == opened.id
            assert [scene.id for scene in client.scenes()].count(opened.id) == 1
            assert {"banana", "cup"} <= {entry.label for entry in opened.dictionary}
            assert client.operation(opened.operation_id).scene_id == opened.id
            assert len(service.photos.all(opened.id).photos) == 26
        finally:
            service.delete_scene(opened.id)


def test_it_is_whole_is_kept_as_it_was_changed_and_comes_anew_after_it_was_deleted(
    empty_service: SceneService, tmp_path: Path
) -> None:
    first = empty_service.open_sample()
    blobs = empty_service._store.blobs
    blobs.check_version(blobs.version(first.id, first.version))
    empty_service._store.scenes.rename(first.id, "mine")
    assert empty_service.open_sample().name == "mine"
    assert _folders(tmp_path) == [first.id]  # nothing of the unpacking is left
    empty_service.delete_scene(first.id)
    second = empty_service.open_sample()
    assert second.id != first.id and second.name == "A table (sample)"
    assert empty_service.in_project("other").open_sample().id != second.id


def test_two_who_ask_at_once_get_one_scene(empty_service: SceneService, tmp_path: Path) -> None:
    scenes = at_once(*[empty_service.open_sample] * 3)
    (scene_id,) = {scene.id for scene in scenes}
    assert _folders(tmp_path) == [scene_id]


def test_it_counts_as_a_scene_of_the_project(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, quotas=QuotaSettings(scenes=1))
    with SceneService(open_store(tmp_path), settings) as service:
        first = service.open_sample()
        assert service.open_sample().id == first.id  # it is there already
        with pytest.raises(QuotaError):
            service.new_upload()
