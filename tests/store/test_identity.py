"""No scene is erased because its database is away, new, another or older: by no worker, no doctor, in no month."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import create_engine, delete, text

from fastsplat.service.store.artefact_settings import ArtefactSettings
from fastsplat.service.store.blobs.activity_clock import ActivityClock
from fastsplat.service.store.blobs.object_store import ObjectStoreBlobs
from fastsplat.service.store.care.backup import back_up, restore
from fastsplat.service.store.rows.records import NewJob, SceneSummary
from fastsplat.service.store.rows.schema import identity, operations, scenes
from fastsplat.service.store.store import Store, open_store
from fastsplat.workers.engine.cleanup import logger, remove_unneeded, trash_lost_scenes
from fastsplat_contract.errors import ConflictError, FastSplatError, ObjectStoreError

_HOUR, _DAY = 3_600.0, 86_400.0
_DATABASE = "data/fastsplat.sqlite"


@pytest.fixture(params=["folder", "object store"])
def artefacts(request: pytest.FixtureRequest, tmp_path: Path) -> ArtefactSettings:
    """Where scenes are stored."""
    return ArtefactSettings(url="" if request.param == "folder" else f"file://{tmp_path}/bucket")


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, Path]:
    """A folder in which `data` has five scenes and their database; and one with the scenes in an object store."""
    folders = {}
    for inside in (True, False):
        folders[inside] = tmp_path_factory.mktemp("seed")
        artefacts = ArtefactSettings(url="" if inside else f"file://{folders[inside]}/bucket")
        with closing(open_store(folders[inside] / "data", "", artefacts)) as store:
            for number in range(5):
                _make(store, f"scene{number}")
    return folders


@pytest.fixture
def place(tmp_path: Path, artefacts: ArtefactSettings, seeds: dict[bool, Path]) -> Path:
    """A copy of the one that fits."""
    shutil.copytree(seeds[not artefacts.url], tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture(autouse=True)
def _every_record() -> Iterator[None]:
    """What was logged in one test may be logged in the next."""
    filters = logger.filters[:]
    logger.filters.clear()
    yield
    logger.filters[:] = filters


def _make(store: Store, scene_id: str) -> None:
    store.scenes.create(NewJob(scene_id, f"op-{scene_id}", "desk", "", "d", f"up-{scene_id}", {}))
    claim = store.jobs.claim(f"op-{scene_id}")
    work = store.blobs.job(claim.operation.id)
    work.mkdir(parents=True)
    (work / "scene.ply").write_text(scene_id)
    store.blobs.publish(work, scene_id, "v1")
    store.jobs.succeed(claim, SceneSummary("v1", 5, "METRIC", (), (), {}, 0))


def _scenes(place: Path) -> list[str]:
    """Ids of the scenes that are stored whole, where they are asked for."""
    folders = [place / "data/scenes", *((place / "bucket/scenes",) if (place / "bucket").is_dir() else ())]
    return sorted(path.name for path in folders[-1].iterdir())


def _work_for_a_month(place: Path, artefacts: ArtefactSettings, database_url: str = "") -> None:
    """What a worker does that is started three times in 33 days: it cleans up, and looks at the clock once an hour."""
    now = [ActivityClock(place / "data").now() + 2 * _HOUR]
    clock = ActivityClock(place / "data", lambda: now[0])
    for _ in range(3):
        try:
            store = open_store(place / "data", database_url, artefacts)
        except ConflictError:
            continue
        with closing(store):
            remove_unneeded(store, -1.0, 60.0, 60.0)
            for hour in range(11 * 24):
                now[0] += _HOUR
                clock.now()
                if hour % 24 == 0:
                    trash_lost_scenes(store, clock.now())


def test_started_without_its_database_all_is_there_a_month_later(place: Path, artefacts: ArtefactSettings) -> None:
    before = _scenes(place)
    (place / _DATABASE).rename(place / "elsewhere")
    with pytest.raises(ConflictError, match="there is no database") as caught:
        open_store(place / "data", "", artefacts)
    assert "restore a backup" in caught.value.hint and "--adopt" in caught.value.hint
    assert not (place / _DATABASE).exists()  # the right one can be put there
    _work_for_a_month(place, artefacts)
    assert _scenes(place) == before
    (place / "elsewhere").rename(place / _DATABASE)
    open_store(place / "data", "", artefacts).close()


@pytest.mark.parametrize("database", ["new", "empty", "full"])
def test_with_another_database_all_is_there_a_month_later(
    database: str, place: Path, artefacts: ArtefactSettings, tmp_path: Path
) -> None:
    before, url = _scenes(place), f"sqlite:///{tmp_path}/other.sqlite"
    if database != "new":
        with closing(open_store(tmp_path / "second", url)) as store:
            if database == "full":
                _make(store, "another")
    with pytest.raises(ConflictError):
        open_store(place / "data", url, artefacts)
    _work_for_a_month(place, artefacts, url)
    assert _scenes(place) == before


def test_a_worker_under_which_the_database_is_exchanged_removes_nothing(
    place: Path, artefacts: ArtefactSettings
) -> None:
    before = _scenes(place)
    with closing(open_store(place / "data", "", artefacts)) as store:
        store.blobs.upload("mine").mkdir(parents=True)
        with store.engine.begin() as connection:
            for table in (scenes, operations):
                connection.execute(delete(table))
            connection.execute(identity.update().values(id="another"))
        with pytest.raises(ConflictError):
            remove_unneeded(store, -1.0, 60.0, 60.0)
        with pytest.raises(ConflictError):
            trash_lost_scenes(store, 1e12)
        assert _scenes(place) == before and "mine" in store.blobs.ids("uploads")


def test_an_older_database_put_back_costs_no_scene_that_was_made_since(
    place: Path, artefacts: ArtefactSettings, caplog: pytest.LogCaptureFixture
) -> None:
    shutil.copy(place / _DATABASE, place / "older")
    with closing(open_store(place / "data", "", artefacts)) as store:
        _make(store, "made-since")
    shutil.copy(place / "older", place / _DATABASE)
    _work_for_a_month(place, artefacts)
    assert "made-since" in _scenes(place) and len(_scenes(place)) == 6
    assert "made-since" in caplog.text


def test_a_folder_or_a_database_without_an_id_gets_that_of_the_other(place: Path, artefacts: ArtefactSettings) -> None:
    def forget(*of: str) -> None:
        for path in (place / "data/.identity", place / "bucket/identity"):
            if "folder" in of:
                path.unlink(missing_ok=True)
        if "database" in of:
            engine = create_engine(f"sqlite:///{place / _DATABASE}")
            with engine.begin() as connection:
                connection.execute(delete(identity))
            engine.dispose()

    for of in (("database",), ("folder",)):
        forget(*of)
        with closing(open_store(place / "data", "", artefacts)) as store, store.engine.begin() as connection:
            assert connection.execute(text("SELECT id FROM identity")).all() == [(store.blobs.identity(),)]
    assert len(_scenes(place)) == 5


def test_a_database_whose_scenes_are_elsewhere_is_refused(place: Path) -> None:
    with pytest.raises(ConflictError):
        open_store(place / "new", f"sqlite:///{place / _DATABASE}")


def test_who_adopts_keeps_everything_and_who_had_it_has_it_no_more(place: Path, artefacts: ArtefactSettings) -> None:
    before, url = _scenes(place), f"sqlite:///{place}/other.sqlite"
    open_store(place / "data", url, artefacts, adopting=True).close()
    _work_for_a_month(place, artefacts, url)
    assert _scenes(place) == before
    with pytest.raises(ConflictError):
        open_store(place / "data", "", artefacts)


def test_a_backup_restored_into_another_folder_belongs_together(place: Path, artefacts: ArtefactSettings) -> None:
    with closing(open_store(place / "data", "", artefacts)) as store:
        back_up(store, place / "data", "", place / "backup")
    restore(place / "backup", place / "again", "")
    with closing(open_store(place / "again", "", artefacts)) as store:
        trash_lost_scenes(store, 1e12)
        assert len(store.blobs.ids("scenes")) == 5


def test_scenes_that_lost_their_rows_lie_in_the_trash_for_seven_days(
    place: Path, artefacts: ArtefactSettings, caplog: pytest.LogCaptureFixture
) -> None:
    with closing(open_store(place / "data", "", artefacts)) as store:
        _lose(store, "scene0", "scene1")
        now = ActivityClock(place / "data").now()
        trash_lost_scenes(store, now)  # somebody may be deleting them
        assert len(_scenes(place)) == 5
        now += 2 * _HOUR
        trash_lost_scenes(store, now)
        assert _scenes(place) == ["scene2", "scene3", "scene4"]
        assert [name.partition(".")[0] for name in store.blobs.trashed_scenes()] == ["scene0", "scene1"]
        assert "row of scene scene0 is gone" in caplog.text and "row of scene scene1 is gone" in caplog.text
        store.blobs.remove_partial(-1.0)
        trash_lost_scenes(store, now + 7 * _DAY - 1)
        assert len(store.blobs.trashed_scenes()) == 2
        ply_path = next(path for path in place.rglob("scene.ply") if "trash" in str(path))
        assert ply_path.read_text() in ("scene0", "scene1")
        trash_lost_scenes(store, now + 7 * _DAY + 2)
        assert store.blobs.trashed_scenes() == () and not [p for p in place.rglob("scene.ply") if "trash" in str(p)]


def test_many_scenes_that_lost_their_rows_at_once_stay_and_are_named(
    place: Path, artefacts: ArtefactSettings, caplog: pytest.LogCaptureFixture
) -> None:
    with closing(open_store(place / "data", "", artefacts)) as store:
        _lose(store, "scene0", "scene1", "scene2", "scene3")
        with caplog.at_level(logging.WARNING):
            trash_lost_scenes(store, ActivityClock(place / "data").now() + 40 * _DAY)
    assert len(_scenes(place)) == 5 and "scene0, scene1, scene2, scene3" in caplog.text


def _lose(store: Store, *scene_ids: str) -> None:
    with store.engine.begin() as connection:
        connection.execute(delete(scenes).where(scenes.c.id.in_(scene_ids)))


def test_an_object_store_that_is_away_is_asked_before_anything_is_removed(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    artefacts = ArtefactSettings(url=f"file://{place}/bucket")

    def away(self: ObjectStoreBlobs) -> str | None:
        raise ObjectStoreError("away")

    open_store(place / "data", "", artefacts, adopting=True).close()
    monkeypatch.setattr(ObjectStoreBlobs, "identity", away)
    with closing(open_store(place / "data", "", artefacts)) as store:  # a server starts
        for clean in (lambda: remove_unneeded(store, -1.0, 1.0, 1.0), lambda: trash_lost_scenes(store, 1e12)):
            with pytest.raises(FastSplatError):
                clean()
