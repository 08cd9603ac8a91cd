"""Checkup of database rows: unreadable ones, and references to missing rows."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from sqlalchemy import Column, RowMapping, Table, select

from fastsplat.service.store.blobs.object_store import ObjectStoreBlobs
from fastsplat.service.store.care.checkup import Problem
from fastsplat.service.store.queue.claims import as_attempt
from fastsplat.service.store.repositories.key_repository import ROLES
from fastsplat.service.store.repositories.scene_repository import as_operation, read_verdicts
from fastsplat.service.store.repositories.version_repository import VersionRecord
from fastsplat.service.store.rows.records import OperationRecord, SceneRecord
from fastsplat.service.store.rows.schema import (
    api_keys,
    attempts,
    known_names,
    operations,
    projects,
    quota_usage,
    scene_photos,
    scene_versions,
    scenes,
)
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import ArtefactError, SceneFileError

_RESTORE = "Restore a backup of the database, or delete what the row is about."
_HASH = re.compile(r"[0-9a-f]{64}")
_TABLES = (scenes, operations, attempts, scene_versions, scene_photos, projects, api_keys, quota_usage)
_COLUMNS: Mapping[Table, Sequence[Table | Column[Any]]] = {
    **{table: (table,) for table in _TABLES},
    known_names: (known_names.c.id, known_names.c.version, known_names.c.scene_id),  # other columns are large
}
_POINTING = (
    (scenes, "operation_id", operations), (scenes, "project", projects), (attempts, "operation_id", operations),
    (operations, "project", projects), (operations, "scene_id", scenes),
    (scene_versions, "scene_id", scenes), (known_names, "scene_id", scenes), (scene_photos, "scene_id", scenes),
    (quota_usage, "scene_id", scenes),
    (api_keys, "project", projects), (api_keys, "operation_id", operations), (api_keys, "scene_id", scenes),
)  # fmt: skip
"""References to other tables."""


def check_rows(
    store: Store,
    read_scene: Callable[[SceneRecord], object],
    read_operation: Callable[[OperationRecord], object],
    read_version: Callable[[VersionRecord], object],
    kept_since: float,
) -> Iterator[Problem]:
    """Finds unreadable rows, references to missing rows, and version folders that no row names.

    Args:
        read_scene, read_operation, read_version: build what callers see of a row, or raise `SceneFileError` or
            `ArtefactError`.
        kept_since: seconds since 1970; operations that ended later still have their rows.
    """
    local = () if isinstance(store.blobs, ObjectStoreBlobs) else store.blobs.ids("scenes")
    folders = {name: frozenset(store.blobs.ids(f"scenes/{name}")) for name in local}  # before the rows are read
    with store.engine.execution_options(read_only=True).begin() as connection:
        rows = {
            table.name: connection.execute(select(*columns)).mappings().all() for table, columns in _COLUMNS.items()
        }
    for table, column, target in _POINTING:
        (key,) = target.primary_key.columns
        there = {row[key.name] for row in rows[target.name]}
        for row in rows[table.name]:
            if row[column] not in there and _points(table, column, row, kept_since):
                yield _problem(table, row, f"its {column} {row[column]!r} has no row in {target.name}")
    versions = {(row["scene_id"], row["version"]) for row in rows[scene_versions.name]}
    for row in rows[scenes.name]:
        yield from _unreadable(scenes, row, lambda row: read_scene(SceneRecord(**row)))
        named = {version for scene_id, version in versions if scene_id == row["id"]}
        if named and row["version"] not in named:
            yield _problem(scenes, row, f"its current version {row['version']!r} has no row")
        run_ids = {_run_id(job) for job in rows[operations.name] if job["scene_id"] == row["id"]}
        for version in sorted(folders.get(row["id"], frozenset()) - named - run_ids - {row["version"]}):
            hint = "Restore a database that has it; or, if nobody needs it, remove the folder."
            yield Problem(f"scenes/{row['id']}/{version}", "no row names this version: is it the right database?", hint)
    for row in rows[operations.name]:
        yield from _unreadable(operations, row, lambda row: read_operation(as_operation(row)))
    for row in rows[attempts.name]:
        yield from _unreadable(attempts, row, as_attempt)
    authors = {"", *(row["name"] for row in rows[api_keys.name])}
    for row in rows[scene_versions.name]:
        yield from _unreadable(scene_versions, row, lambda row: read_version(VersionRecord(**row)))
        if row["parent"] and (row["scene_id"], row["parent"]) not in versions:
            yield _problem(scene_versions, row, f"the version {row['parent']!r} that it was made of has no row")
        if row["author"] not in authors:
            yield _problem(scene_versions, row, f"no key is called {row['author']!r}, as its author")
    for row in rows[scene_photos.name]:
        yield from _unreadable(scene_photos, row, read_verdicts)
    for row in rows[api_keys.name]:
        if row["role"] not in ROLES or not _HASH.fullmatch(str(row["hash"])):
            yield _problem(api_keys, row, "its role or its hash cannot be read")
    for row in rows[quota_usage.name]:
        if not isinstance(row["bytes"], int) or row["bytes"] < 0:
            yield _problem(quota_usage, row, f"{row['bytes']} bytes")


def _points(table: Table, column: str, row: RowMapping, kept_since: float) -> bool:
    """True unless the row is a finished job, an old key for an upload or a revoked one for a scene."""
    if table is operations and column == "scene_id":
        return row["state"] in ("QUEUED", "RUNNING") and not row["cancel_requested"]
    if table is api_keys and column == "operation_id":
        return row[column] is not None and row["created_at"] > kept_since
    return table is not api_keys or column != "scene_id" or (row[column] != "" and row["revoked_at"] is None)


def _run_id(job: RowMapping) -> str:
    try:
        return as_operation(job).run_id
    except ArtefactError:
        return str(job["id"])


def _unreadable(table: Table, row: RowMapping, read: Callable[[RowMapping], object]) -> Iterator[Problem]:
    try:
        read(row)
    except (SceneFileError, ArtefactError) as error:
        yield _problem(table, row, error.message)


def _problem(table: Table, row: RowMapping, message: str) -> Problem:
    name = "/".join(str(row[column.name]) for column in table.primary_key.columns)
    return Problem(f"database, {table.name} {name}", message, _RESTORE)
