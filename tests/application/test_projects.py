"""Projects: what is in one does not exist for another, down to request ids, uploads and quotas."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.types import ValidatedUpload
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import ConflictError, InvalidInputError, NotFoundError
from fastsplat_contract.exports import ExportRequest
from fastsplat_contract.operations import Operation, SceneOptions
from fastsplat_contract.queries import QueryRequest
from fastsplat_contract.scenes import Edit


def _admit(folder: Path, settings: CaptureSettings, strict: bool) -> ValidatedUpload:
    return ValidatedUpload(folder, "images", 1)


@pytest.fixture
def opened(tmp_path: Path, database_url: str) -> Iterator[SceneService]:
    with open_service(Settings(data_dir=tmp_path, database_url=database_url), _admit) as service:
        service.admin.projects.create("a")
        service.admin.projects.create("b")
        yield service


def _post(service: SceneService, request_id: str = "", content: bytes = b"picture") -> Operation:
    with service.new_upload() as upload:
        upload.write("a.jpg", [content])
        return service.create_scene(upload, "a place", request_id, SceneOptions())


_ABOUT_A_SCENE: dict[str, Callable[[SceneService, str], object]] = {
    "get_scene": lambda service, scene: service.get_scene(scene),
    "list_labels": lambda service, scene: service.list_labels(scene),
    "list_versions": lambda service, scene: service.versions.all(scene),
    "current_version": lambda service, scene: service.versions.resolve(scene),
    "scene_ply": lambda service, scene: service.answers.scene_ply(scene),
    "export": lambda service, scene: service.exports.file(ExportRequest(scene)),
    "query": lambda service, scene: service.answers.query(QueryRequest(scene, ("mug",))).answers,
    "edit_scene": lambda service, scene: service.versions.edit(scene, [Edit("remove", label="mug")]),
    "undo_edit": lambda service, scene: service.versions.undo(scene, ""),
    "delete_scene": lambda service, scene: service.delete_scene(scene),
}


def test_a_scene_of_another_project_is_not_there(opened: SceneService) -> None:
    mine, theirs = opened.in_project("a"), opened.in_project("b")
    scene_id = _post(mine).scene_id
    for name, call in _ABOUT_A_SCENE.items():
        for other in (theirs, opened):
            with pytest.raises(NotFoundError) as caught:
                call(other, scene_id)
            with pytest.raises(NotFoundError) as nothing:
                call(other, "0" * 32)
            assert caught.value.message.replace(scene_id, "0" * 32) == nothing.value.message, name
        assert mine.get_scene(scene_id).state == "TRAINING", name


def test_operations_and_lists_are_a_projects_own(opened: SceneService) -> None:
    mine, theirs = opened.in_project("a"), opened.in_project("b")
    operation, other = _post(mine), _post(theirs)
    for call in (theirs.get_operation, theirs.cancel_operation, opened.get_operation):
        with pytest.raises(NotFoundError):
            call(operation.id)
    assert [row.id for row in mine.list_operations().operations] == [operation.id]
    assert [row.id for row in theirs.list_scenes().scenes] == [other.scene_id]
    assert opened.list_scenes() == ((), "") and opened.answers.query(QueryRequest("", ("mug",))).answers == ()
    assert mine.cancel_operation(operation.id).state == "CANCELLED"
    assert theirs.get_operation(other.id).state == "QUEUED"


def test_request_ids_of_two_projects_never_meet(opened: SceneService) -> None:
    mine, theirs = opened.in_project("a"), opened.in_project("b")
    first = _post(mine, "once")
    same, differs = _post(theirs, "once"), _post(opened, "once", b"other content")
    assert len({first.id, same.id, differs.id}) == 3
    assert _post(mine, "once").id == first.id and _post(theirs, "once").id == same.id
    with pytest.raises(ConflictError):
        _post(theirs, "once", b"other content")


def test_unfinished_uploads_are_a_projects_own(opened: SceneService) -> None:
    uploads = opened.resumable
    upload = uploads.create("a", "a.zip", 3)
    for call in (
        lambda: uploads.get("b", upload.id),
        lambda: uploads.append("b", upload.id, 0, [b"abc"]),
        lambda: uploads.complete("b", upload.id),
        lambda: uploads.delete("b", upload.id),
    ):
        with pytest.raises(NotFoundError):
            call()
    assert uploads.append("a", upload.id, 0, [b"abc"]).offset == 3


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


def test_a_key_of_no_project_or_role_is_not_made(opened: SceneService) -> None:
    with pytest.raises(NotFoundError) as caught:
        opened.admin.keys.create("robot", "editor", project="nowhere")
    assert caught.value.field == "project"
    with pytest.raises(InvalidInputError):
        opened.admin.keys.create("robot", "write")
    assert opened.admin.keys.all() == ()
