"""Checkup of a database's rows: those that nobody can read, and those that name what is not there."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import partial

from sqlalchemy import RowMapping, Table, select

from fastsplat.service.store.checkup import Problem
from fastsplat.service.store.key_repository import ROLES
from fastsplat.service.store.object_store import ObjectStoreBlobs
from fastsplat.service.store.photo_repository import read_verdicts
from fastsplat.service.store.records import OperationRecord, SceneRecord
from fastsplat.service.store.scene_repository import as_operation
from fastsplat.service.store.schema import (
    api_keys,
    operations,
    projects,
    quota_usage,
    scene_photos,
    scene_versions,
    scenes,
)
from fastsplat.service.store.store import Store
from fastsplat.service.store.version_repository import VersionRecord
from fastsplat_contract.errors import ArtefactError, SceneFileError

_RESTORE = "Restore a backup of the database, or delete what the row is about."
_HASH = re.compile(r"[0-9a-f]{64}")


def check_rows(
    store: Store,
    read_scene: Callable[[SceneRecord], object],
    read_operation: Callable[[OperationRecord], object],
    read_version: Callable[[VersionRecord], object],
) -> Iterator[Problem]:
    """Rows that cannot be read, and that name what is not there; and folders of versions that no row names.

    Args:
        store: whose.
        read_scene, read_operation, read_version: make what callers see of a row, and raise `SceneFileError` or
            `ArtefactError` if that cannot be done.
    """
    folders = {} if isinstance(store.blobs, ObjectStoreBlobs) else _folders(store)  # listed before the rows are read
    with store.engine.execution_options(read_only=True).begin() as connection:
        rows = {
            table.name: connection.execute(select(table)).mappings().all()
            for table in (scenes, operations, scene_versions, scene_photos, projects, api_keys, quota_usage)
        }
    own = {row["name"] for row in rows[projects.name]}
    jobs = {row["id"]: row for row in rows[operations.name]}
    versions = {(row["scene_id"], row["version"]) for row in rows[scene_versions.name]}
    for row in rows[scenes.name]:
        problem = partial(_problem, scenes, row["id"])
        yield from _unreadable(problem, row, lambda row: read_scene(SceneRecord(**row)))
        if row["operation_id"] not in jobs:
            yield problem(f"its operation {row['operation_id']} has no row")
        if row["project"] not in own:
            yield problem(f"its project {row['project']!r} has no row")
        named = {version for scene_id, version in versions if scene_id == row["id"]}
        if named and row["version"] not in named:
            yield problem(f"its current version {row['version']!r} has no row")
        made = {_run_id(job) for job in jobs.values() if job["scene_id"] == row["id"]}
        for version in sorted(folders.get(row["id"], frozenset()) - named - made - {row["version"]}):
            hint = "Restore a database that has it; or, if nobody needs it, remove the folder."
            yield Problem(f"scenes/{row['id']}/{version}", "no row names this version: is it the right database?", hint)
    for row in rows[operations.name]:
        problem = partial(_problem, operations, row["id"])
        yield from _unreadable(problem, row, lambda row: read_operation(as_operation(row)))
        if row["project"] not in own:
            yield problem(f"its project {row['project']!r} has no row")
    for row in rows[scene_versions.name]:
        problem = partial(_problem, scene_versions, f"{row['scene_id']}/{row['version']}")
        yield from _unreadable(problem, row, lambda row: read_version(VersionRecord(**row)))
        if row["parent"] and (row["scene_id"], row["parent"]) not in versions:
            yield problem(f"the version {row['parent']!r} that it was made of has no row")
    for row in rows[scene_photos.name]:
        yield from _unreadable(partial(_problem, scene_photos, row["scene_id"]), row, read_verdicts)
    for row in rows[api_keys.name]:
        if row["role"] not in ROLES or not _HASH.fullmatch(str(row["hash"])):
            yield _problem(api_keys, row["id"], "its role or its hash cannot be read")
    for row in rows[quota_usage.name]:
        if not isinstance(row["bytes"], int) or row["bytes"] < 0:
            yield _problem(quota_usage, row["scene_id"], f"{row['bytes']} bytes")


def _folders(store: Store) -> dict[str, frozenset[str]]:
    return {scene_id: frozenset(store.blobs.ids(f"scenes/{scene_id}")) for scene_id in store.blobs.ids("scenes")}


def _run_id(job: RowMapping) -> str:
    try:
        return as_operation(job).run_id
    except ArtefactError:
        return str(job["id"])


def _unreadable(
    problem: Callable[[str], Problem], row: RowMapping, read: Callable[[RowMapping], object]
) -> Iterator[Problem]:
    try:
        read(row)
    except (SceneFileError, ArtefactError) as error:
        yield problem(error.message)


def _problem(table: Table, name: str, message: str) -> Problem:
    return Problem(f"database, {table.name} {name}", message, _RESTORE)
