"""Quotas: what one project may hold, whatever others hold, also when many ask at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.settings import QuotaSettings, Settings
from fastsplat_contract.errors import QuotaError
from fastsplat_contract.jobs.operations import SceneOptions
from tests.at_once import at_once


@pytest.fixture
def opened(tmp_path: Path, database_url: str) -> Iterator[Callable[..., SceneService]]:
    services: list[SceneService] = []

    def admit(folder: Path, settings: CaptureSettings, strict: bool) -> ValidatedUpload:
        return ValidatedUpload(folder, "images", 2)

    def open_with(**quotas: Any) -> SceneService:
        settings = Settings(data_dir=tmp_path, database_url=database_url, quotas=QuotaSettings(**quotas))
        services.append(open_service(settings, admit))
        return services[-1]

    yield open_with
    for service in services:
        service.close()


def _post(service: SceneService, project: str, size: int = 10) -> str:
    project_service = service.in_project(project)
    with project_service.new_upload() as upload:
        upload.write("a.jpg", [b"x" * size])
        return project_service.create_scene(upload, "", "", SceneOptions()).scene_id


def _uploads(tmp_path: Path) -> int:
    return len(list((tmp_path / "uploads").iterdir()))


def test_scenes_are_counted_by_project_and_come_back_when_deleted(
    opened: Callable[..., SceneService], tmp_path: Path
) -> None:
    service = opened(scenes=2)
    first, _ = _post(service, "a"), _post(service, "a")
    with pytest.raises(QuotaError) as caught:
        _post(service, "a")
    assert caught.value.reason == "QUOTA" and "FASTSPLAT_QUOTAS__SCENES" in caught.value.limit
    assert _uploads(tmp_path) == 2
    _post(service, "b")
    service.in_project("a").delete_scene(first)
    _post(service, "a")


def test_bytes_are_counted_with_those_of_unfinished_uploads(
    opened: Callable[..., SceneService], tmp_path: Path
) -> None:
    service = opened(stored_bytes=100)
    _post(service, "a", 60)
    with pytest.raises(QuotaError, match="bytes"):
        _post(service, "a", 41)
    assert _uploads(tmp_path) == 1 and len(service.in_project("a").list_scenes()[0]) == 1
    pending = service.resumable.create("a", "a.zip", 40)
    with pytest.raises(QuotaError):
        service.resumable.create("a", "b.zip", 1)
    service.resumable.create("b", "b.zip", 100)
    service.resumable.delete("a", pending.id)
    service.resumable.create("a", "b.zip", 1)


def test_jobs_that_wait_are_bounded_and_a_cancelled_one_makes_room(opened: Callable[..., SceneService]) -> None:
    service = opened(queued_jobs=1)
    scene_id = _post(service, "a")
    with pytest.raises(QuotaError, match="jobs"):
        _post(service, "a")
    mine = service.in_project("a")
    operation_id = mine.get_scene(scene_id).operation_id
    mine.cancel_operation(operation_id)
    _post(service, "a")
    with pytest.raises(QuotaError, match="jobs"):
        mine.retry_operation(operation_id)


def test_many_at_once_pass_no_bound(opened: Callable[..., SceneService]) -> None:
    service = opened(scenes=3)
    outcomes = at_once(*[lambda: _post(service, "a")] * 8)
    assert [type(outcome) for outcome in outcomes].count(QuotaError) == 5
    assert len(service.in_project("a").list_scenes()[0]) == 3
