"""A version is a folder and a row; what is acknowledged is there, and undo, redo and restore are exact."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.settings import CallSettings, Settings
from fastsplat.service.store.artefact_settings import ArtefactSettings
from fastsplat.service.store.repositories.version_repository import NewVersion, VersionRepository
from fastsplat.service.store.rows.records import NewJob
from fastsplat.workers.engine.cleanup import trash_lost_versions
from fastsplat_contract.errors import DatabaseError
from fastsplat_contract.messages.scenes import Color, Edit
from tests.api.made_scene import ENCODER, add_scene, write_words
from tests.application.version_machine import LIMIT, Place, run

_DAY_S = 24 * 3600.0
_EDITS = [Edit("recolor", label="mug", color=Color(0.0, 0.5, 1.0))]


@pytest.fixture(params=["data folder", "object store"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[SceneService, str]]:
    """A service with a scene that was edited once, and the scene's id."""
    write_words(tmp_path / "models")
    url = (tmp_path / "objects").as_uri() if request.param == "object store" else ""
    settings = Settings(
        data_dir=tmp_path / "data", models=tmp_path / "models", artefacts=ArtefactSettings(url=url),
        query=QuerySettings(backend="reference"),
    )  # fmt: skip
    with open_service(settings) as service:
        assert open_text_encoder(ENCODER, settings.models)
        scene_id = add_scene(service, settings)
        service.versions.edit(scene_id, _EDITS)
        yield service, scene_id


def _versions(service: SceneService, scene_id: str) -> set[str]:
    """Names of the versions that have a folder."""
    return {version for scene, version in service._store.blobs.versions() if scene == scene_id} | {"1"}


def test_an_edit_whose_answer_the_database_lost_is_there(
    place: tuple[SceneService, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    service, scene_id = place
    publish = VersionRepository.publish

    def lose_answer(versions: VersionRepository, new: NewVersion) -> None:
        publish(versions, new)
        raise DatabaseError("the connection broke off")

    with monkeypatch.context() as patch:
        patch.setattr(VersionRepository, "publish", lose_answer)
        with pytest.raises(DatabaseError):
            service.versions.edit(scene_id, _EDITS, "once")
    head = service.versions.all(scene_id)[-1]
    assert head.current and {version.version for version in service.versions.all(scene_id)} == _versions(
        service, scene_id
    )
    assert service.versions.edit(scene_id, _EDITS, "once") == head
    assert service.answers.list_objects(scene_id).objects


def test_a_folder_that_got_no_row_goes_to_the_trash_after_a_day(
    place: tuple[SceneService, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    service, scene_id = place
    store, rows = service._store, {version.version for version in service.versions.all(scene_id)}

    def vanish(*_: object) -> None:
        raise DatabaseError("the database is away")

    with monkeypatch.context() as patch:
        patch.setattr(VersionRepository, "publish", vanish)
        patch.setattr(VersionRepository, "is_published", vanish)
        with pytest.raises(DatabaseError):
            service.versions.edit(scene_id, _EDITS)
    (lost,) = _versions(service, scene_id) - rows
    trash_lost_versions(store, time.time() + 0.9 * _DAY_S)
    assert _versions(service, scene_id) == rows | {lost}
    trash_lost_versions(store, time.time() + 1.1 * _DAY_S)
    assert _versions(service, scene_id) == rows
    trashed = [path for path in store.blobs.root.parent.glob("*/trash/**/scene.ply") if lost in str(path)]
    assert len(trashed) == 1
    trash_lost_versions(store, time.time() + 30 * _DAY_S)
    assert _versions(service, scene_id) == rows and service.versions.undo(scene_id).version == "1"


def test_what_an_unfinished_job_or_an_older_database_explains_stays(place: tuple[SceneService, str]) -> None:
    service, scene_id = place
    store, rows = service._store, {version.version for version in service.versions.all(scene_id)}
    head = max(rows)

    def add_folder(name: str) -> None:
        source = store.blobs.upload(name)
        source.mkdir(parents=True)
        os.link(store.blobs.version(scene_id, head) / "scene.ply", source / "scene.ply")
        store.blobs.publish(source, scene_id, name)

    store.scenes.add_job(NewJob(scene_id, "running", "", "", "d", "", {}, "look_again"))
    assert store.jobs.claim("running")
    add_folder("running")
    trash_lost_versions(store, time.time() + 30 * _DAY_S)
    assert _versions(service, scene_id) == rows | {"running"}
    for number in range(4):
        add_folder(f"later{number}")
    trash_lost_versions(store, time.time() + 30 * _DAY_S)
    assert len(_versions(service, scene_id)) == len(rows) + 5


def test_every_acknowledged_call_is_in_the_one_history_of_its_scene(tmp_path: Path, database_url: str) -> None:
    """SQLite: two servers of one data folder. PostgreSQL: two machines that share that and an object store alone."""
    objects = tmp_path / "objects"
    artefacts = ArtefactSettings(url=objects.as_uri() if database_url else "")
    write_words(tmp_path / "models")
    encoder = open_text_encoder(ENCODER, tmp_path / "models")
    with ExitStack() as stack:
        first, second = (
            stack.enter_context(
                open_service(
                    Settings(
                        data_dir=tmp_path / ("data", "elsewhere")[bool(database_url) and number],
                        database_url=database_url,
                        artefacts=artefacts,
                        models=tmp_path / "models",
                        query=QuerySettings(backend="reference"),
                        calls=CallSettings(max_versions=LIMIT),
                    )
                )
            )
            for number in range(2)
        )
        published = objects if database_url else tmp_path / "data"
        stores = first._store, second._store
        run(Place((first.versions, second.versions), stores, published, encoder, bool(database_url)), scenes=4, steps=8)
