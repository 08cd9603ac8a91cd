"""A backup made of a running service is, once restored, that service: scenes answer, jobs go on."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from fastsplat.service.store.care.backup import back_up, restore
from fastsplat.service.store.store import open_store
from fastsplat_contract.errors import ConflictError, InvalidInputError, NotFoundError
from tests.postgres import PostgresServer
from tests.workers.deployment import Deployment, on_both_databases


def _back_up(deployment: Deployment, target: Path):
    settings = deployment.settings
    return back_up(deployment.service._store, settings.data_dir, settings.database_url, target)


def _content(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@on_both_databases()
def test_restored_a_running_service_has_its_scenes_and_finishes_its_jobs(
    deployment: Deployment, postgres: PostgresServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done, running = deployment.post(request_id="done"), deployment.post("training:sleep 600", request_id="running")
    waiting = deployment.post(request_id="waiting")
    deployment.start_worker()
    deployment.wait_in("training", running)
    scene = deployment.service.get_scene(done.scene_id)
    assert scene.state == "READY"
    before = _content(deployment.service._store.blobs.version(scene.id, scene.version))

    reader, secret = deployment.service.admin.keys.create("a reader", "reader", 3_600.0)
    with monkeypatch.context() as patch:
        patch.setenv("PATH", "")  # no program of a database's is needed
        report = _back_up(deployment, tmp_path / "backup")
    assert {path.name for path in (tmp_path / "backup/files").iterdir()} <= {"scenes", "uploads", "key"}
    projects = deployment.service.admin.projects.all()
    later = deployment.post(request_id="later")
    deployment.service.delete_scene(scene.id)

    assert (report.scenes, report.versions, report.uploads, report.missing) == (1, 1, 2, ())
    with postgres.database() as database:
        url = database if deployment.settings.database_url else ""
        (tmp_path / "again").mkdir()
        restore(tmp_path / "backup", tmp_path / "again" / "data", url)
        again = Deployment(tmp_path / "again", url)
        try:
            restored = again.service.get_scene(scene.id)
            assert (restored.state, restored.version, restored.dictionary) == ("READY", scene.version, scene.dictionary)
            assert _content(again.service._store.blobs.version(scene.id, scene.version)) == before
            assert again.service.admin.keys.valid().find(secret) == reader
            assert again.service.admin.projects.all() == projects
            again.service.cancel_operation(running.id)
            again.start_worker()
            assert again.wait_over(waiting).state == "SUCCEEDED"
            assert again.wait_over(running).state == "CANCELLED"
            assert again.post(request_id="done").id == done.id
            with pytest.raises(NotFoundError):
                again.service.get_operation(later.id)
        finally:
            again.close()


@pytest.mark.parametrize("deployment", ["postgresql"], indirect=True)
def test_a_database_with_something_in_it_is_not_restored_over(deployment: Deployment, tmp_path: Path) -> None:
    waiting = deployment.post(request_id="waiting")
    _back_up(deployment, tmp_path / "backup")
    with pytest.raises(ConflictError):
        restore(tmp_path / "backup", tmp_path / "again", deployment.settings.database_url)
    assert deployment.service.get_operation(waiting.id).state == "QUEUED"


def test_a_scene_that_is_deleted_while_it_is_saved_is_whole_or_not_there(tmp_path: Path, monkeypatch) -> None:
    deployment = Deployment(tmp_path, "")
    try:
        deployment.start_worker()
        gone, stays = deployment.post(), deployment.post()
        for operation in (gone, stays):
            assert deployment.wait_over(operation).state == "SUCCEEDED"
        link = os.link

        def link_and_delete(source: str, target: str) -> None:
            monkeypatch.setattr(os, "link", link)
            deployment.service.delete_scene(gone.scene_id)
            deployment.service.delete_scene(stays.scene_id) if gone.scene_id not in source else None
            link(source, target)

        monkeypatch.setattr(os, "link", link_and_delete)
        report = _back_up(deployment, tmp_path / "backup")
        assert report.missing == () and report.scenes <= 1
        restore(tmp_path / "backup", tmp_path / "again", "")
        store = open_store(tmp_path / "again")
        for scene in store.scenes.list_scenes(10):
            assert {path.name for path in store.blobs.version(scene.id, scene.version).iterdir()} >= {"artefact"}
        store.close()
    finally:
        deployment.close()


@pytest.fixture(scope="module")
def backup(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("saved")
    deployment = Deployment(folder, "")
    deployment.start_worker()
    assert deployment.wait_over(deployment.post()).state == "SUCCEEDED"
    _back_up(deployment, folder / "backup")
    yield folder / "backup"
    deployment.close()


def test_a_backup_is_never_written_over_and_restored_into_an_empty_folder_only(backup: Path, tmp_path: Path) -> None:
    store = open_store(tmp_path / "data")
    with pytest.raises(ConflictError):
        back_up(store, tmp_path / "data", "", backup)
    store.close()
    with pytest.raises(ConflictError):
        restore(backup, tmp_path / "data", "")
    with pytest.raises(NotFoundError):
        restore(tmp_path, tmp_path / "new", "")
    with pytest.raises(InvalidInputError):
        restore(backup, tmp_path / "new", "postgresql://user@localhost/name")
    assert not (tmp_path / "new").exists()


def test_a_flipped_bit_anywhere_in_a_backup_is_found_before_anything_is_restored(backup: Path, tmp_path: Path) -> None:
    names = json.loads((backup / "backup.json").read_text())["entries"]
    assert len(names) > 4
    for name in names:
        path = backup / name
        before = path.read_bytes()
        data = bytearray(before)
        data[len(data) // 2] ^= 1
        path.unlink()  # it is linked with the data folder's own
        path.write_bytes(bytes(data))
        with pytest.raises(InvalidInputError, match="damaged"):
            restore(backup, tmp_path / "new", "")
        assert not (tmp_path / "new").exists()
        path.write_bytes(before)
    restore(backup, tmp_path / "new", "")
    assert not any(path.stat().st_mode & 0o077 for path in (tmp_path / "new", *(tmp_path / "new").rglob("*.sqlite")))


def test_the_command_saves_and_restores(backup: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "FASTSPLAT_DATA_DIR": str(tmp_path / "data")}
    command = [sys.executable, "-m", "fastsplat.cli.main"]
    restored = subprocess.run([*command, "restore", str(backup)], env=environment, check=True, capture_output=True)
    assert b"1 scenes in 1 versions" in restored.stdout
    saved = subprocess.run([*command, "backup", str(tmp_path / "b")], env=environment, check=True, capture_output=True)
    assert b"1 scenes in 1 versions" in saved.stdout
    assert sorted(_content(tmp_path / "b" / "files")) == sorted(_content(backup / "files"))
