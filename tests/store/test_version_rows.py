"""Rows of versions: one order for good, one writer at a time on either database, and nothing taken from an undo."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from fastsplat.service.store.repositories.version_repository import NewVersion
from fastsplat.service.store.rows.records import NewJob
from fastsplat.service.store.store import Store, open_store
from fastsplat_contract.errors import ConflictError, NotFoundError
from tests.at_once import at_once
from tests.store.test_repositories import SUMMARY, job

_TRIALS = 6  # so many times writers race; without a lock, two of them are acknowledged nearly each time


@pytest.fixture
def stores(tmp_path: Path, database_url: str) -> Iterator[tuple[Store, Store]]:
    """One database as two servers open it."""
    both = open_store(tmp_path / "data", database_url), open_store(tmp_path / "data", database_url)
    yield both
    for store in both:
        store.close()


def _scene(store: Store, number: int = 1) -> str:
    """Id of a READY scene."""
    scene_id = f"scene{number}"
    store.scenes.create(job(number))
    store.jobs.succeed(store.jobs.claim(f"op{number}"), replace(SUMMARY, version="trained"))
    return scene_id


def _new(scene_id: str, name: str, parent: str, max_versions: int | None = None) -> NewVersion:
    """A version whose request id says nothing of its age, as those of clients do."""
    return NewVersion(scene_id, name, parent, uuid.uuid4().hex, "d", 5, (), (), 0, max_versions=max_versions)


def _lineage(store: Store, scene_id: str) -> list[str]:
    """The current version and all before it, newest first."""
    scene = store.scenes.scene(scene_id)
    parents = {row.version: row.parent for row in store.versions.of(scene)}
    names = [scene.version]
    while parents[names[-1]]:
        names.append(parents[names[-1]])
    return names


_WRITES: dict[str, Callable[[Store, str, str], object]] = {
    "publish": lambda store, scene_id, name: store.versions.publish(_new(scene_id, name, "first")),
    "step_back": lambda store, scene_id, name: store.versions.step_back(scene_id, "first"),
    "step_forward": lambda store, scene_id, name: store.versions.step_forward(scene_id, "first"),
    "restore": lambda store, scene_id, name: store.versions.restore(scene_id, "undone", "first"),
    "end of a job": lambda store, scene_id, name: store.jobs.succeed_with_version(
        store.jobs.claim(f"job of {scene_id}"), NewVersion(scene_id, name, "first", "", "", 5, (), (), 0), {}
    ),
}


_LINEAGES = {  # versions in force after some of them
    "step_back": ["trained"],
    "step_forward": ["undone", "first", "trained"],
    "restore": ["undone", "first", "trained"],
}


@pytest.mark.parametrize(
    ("first", "second"), [*(("publish", write) for write in _WRITES), ("end of a job", "step_back")]
)
def test_of_two_writers_that_saw_the_same_version_one_is_refused(
    stores: tuple[Store, Store], first: str, second: str
) -> None:
    for number in range(_TRIALS):
        scene_id = _scene(stores[0], number)
        stores[0].scenes.add_job(NewJob(scene_id, f"job of {scene_id}", "", "", "d", "", {"labels": []}))
        stores[0].versions.publish(_new(scene_id, "first", "trained"))
        stores[0].versions.publish(_new(scene_id, "undone", "first"))
        stores[0].versions.step_back(scene_id, "undone")
        writes = zip((first, second), stores, ("by0", "by1"), strict=True)
        outcomes = at_once(*(partial(_WRITES[write], store, scene_id, name) for write, store, name in writes))
        done = [not isinstance(outcome, ConflictError | NotFoundError) for outcome in outcomes]
        assert sorted(done) == [False, True], (first, second, number)
        current = _lineage(stores[0], scene_id)
        lineage = [f"by{done.index(True)}", "first", "trained"]
        assert current == (_LINEAGES.get(second, lineage) if done[1] else lineage)


def test_a_version_that_is_restored_is_not_removed_at_the_same_moment(stores: tuple[Store, Store]) -> None:
    for number in range(_TRIALS):
        scene_id = _scene(stores[0], number)
        stores[0].versions.publish(_new(scene_id, "old", "trained"))
        stores[0].versions.publish(_new(scene_id, "new", "old"))
        newest = _new(scene_id, "newest", "new", max_versions=2)
        at_once(partial(stores[0].versions.publish, newest), partial(stores[1].versions.restore, scene_id, "old"))
        scene = stores[0].scenes.scene(scene_id)
        assert scene.version in {row.version for row in stores[0].versions.of(scene)}


def test_a_redo_goes_to_the_version_that_was_left_whatever_the_clocks_say(
    stores: tuple[Store, Store], monkeypatch: pytest.MonkeyPatch
) -> None:
    store = stores[0]
    scene_id, now = _scene(store), time.time()
    for name in ("first", "second"):
        store.versions.publish(_new(scene_id, name, "trained"))
        store.versions.step_back(scene_id, name)
    assert store.versions.step_forward(scene_id, "trained").version == "second"
    store.versions.restore(scene_id, "first", "second")
    monkeypatch.setattr(time, "time", lambda: now - 3600)  # another machine's clock
    assert store.versions.step_back(scene_id, "first").version == "trained"
    assert store.versions.step_forward(scene_id, "trained").version == "first"


def test_versions_go_in_the_transaction_that_deletes_their_scene(stores: tuple[Store, Store]) -> None:
    scene_id = _scene(stores[0])
    stores[0].versions.publish(_new(scene_id, "first", "trained"))
    stores[0].scenes.delete_scene(scene_id)
    assert not stores[1].versions.known(scene_id, "first") and not stores[1].versions.known(scene_id, "trained")
