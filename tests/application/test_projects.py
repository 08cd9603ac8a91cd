"""Projects: what is in one does not exist for another, down to request ids, uploads and quotas."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import ConflictError, InvalidInputError
from fastsplat_contract.jobs.operations import Operation, SceneOptions
from tests.scenes import stand_in_models


@pytest.fixture
def opened(tmp_path: Path, database_url: str) -> Iterator[SceneService]:
    models = stand_in_models(tmp_path / "models", "minilm_l6_int8")
    with open_service(
        Settings(data_dir=tmp_path, models=models, database_url=database_url),
        lambda folder, settings, strict: ValidatedUpload(folder, "images", 1),
    ) as service:
        service.admin.projects.create("a")
        service.admin.projects.create("b")
        yield service


def _post(service: SceneService, request_id: str = "", content: bytes = b"picture") -> Operation:
    with service.new_upload() as upload:
        upload.write("a.jpg", [content])
        return service.create_scene(upload, "a place", request_id, SceneOptions())


def test_request_ids_of_two_projects_never_meet(opened: SceneService) -> None:
    mine, theirs = opened.in_project("a"), opened.in_project("b")
    first = _post(mine, "once")
    same, differs = _post(theirs, "once"), _post(opened, "once", b"other content")
    assert len({first.id, same.id, differs.id}) == 3
    assert _post(mine, "once").id == first.id and _post(theirs, "once").id == same.id
    with pytest.raises(ConflictError):
        _post(theirs, "once", b"other content")


def test_projects_have_plain_names_of_their_own(opened: SceneService) -> None:
    for name in ("", "A", "a b", "-a", "a" * 64, "a/b", "ä", "a\n"):
        with pytest.raises(InvalidInputError):
            opened.admin.projects.create(name)
    with pytest.raises(ConflictError):
        opened.admin.projects.create("default")
    _post(opened.in_project("a"))
    opened.admin.keys.create("robot", "editor", project="a")
    counts = [(record.name, record.scenes, record.keys) for record in opened.admin.projects.all().projects]
    assert counts == [("a", 1, 1), ("b", 0, 0), ("default", 0, 0)]
