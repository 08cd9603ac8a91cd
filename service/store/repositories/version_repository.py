"""Scene versions in the database: their tree, and which one is current.

A scene that was never edited has no rows here: its trained version is the only one. Writers of a scene's versions lock
its row first (`locked_scene`), so that of two that saw the same current version one is refused.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from sqlalchemy import Connection, delete, exists, func, insert, select, update
from sqlalchemy.exc import IntegrityError

from fastsplat.service.store.repositories.name_repository import VersionNames, forget_names, record_names
from fastsplat.service.store.repositories.scene_repository import no_scene, requested_before
from fastsplat.service.store.rows.damaged_rows import are_objects, is_name, require, require_fields
from fastsplat.service.store.rows.database import Repository
from fastsplat.service.store.rows.records import SceneRecord
from fastsplat.service.store.rows.schema import scene_versions, scenes
from fastsplat_contract.errors import ConflictError, NotFoundError


@dataclass(frozen=True)
class VersionRecord:
    """A version; `edits`, `scaling`, `alignment` and `quality` are JSON of the service layer."""

    scene_id: str
    version: str
    number: int  # from 1, the trained one
    parent: str
    created_at: float
    request_id: str | None
    request_digest: str
    gaussians: int
    dictionary: Sequence[Mapping[str, Any]]
    edits: Sequence[Mapping[str, Any]]
    quality: Mapping[str, Any]
    objects: int
    current_at: float | None = None  # when it last ceased to be current; None: never
    author: str = ""  # name of its access key
    scaling: Mapping[str, Any] | None = None
    alignment: Mapping[str, Any] | None = None
    current: bool = False

    def __post_init__(self) -> None:
        require_fields(
            f"version {self.version} of scene {self.scene_id}",
            self,
            version=is_name(self.version),
            dictionary=are_objects(self.dictionary, "label_id", "label"),
        )


@dataclass(frozen=True)
class NewVersion:
    """A version to become current; its folder is in place.

    It inherits its parent's `scaling` and `alignment` if None, and the parts of `quality` that it does not replace.
    Beyond `max_versions` (None: no limit) undone versions are removed first, then the oldest, but never the current,
    new and trained ones; children of a removed version become those of its parent.
    """

    scene_id: str
    version: str
    parent: str
    request_id: str
    request_digest: str
    gaussians: int
    dictionary: Sequence[Mapping[str, Any]]
    edits: Sequence[Mapping[str, Any]]
    objects: int
    names: VersionNames = field(default_factory=VersionNames)
    author: str = ""
    scaling: Mapping[str, Any] | None = None
    alignment: Mapping[str, Any] | None = None
    quality: Mapping[str, Any] = field(default_factory=dict)
    max_versions: int | None = None


_ROWS = scene_versions.c
_ALL = select(scene_versions, (_ROWS.version == scenes.c.version).label("current")).join(
    scenes, scenes.c.id == _ROWS.scene_id
)
"""In one statement, so that `current` is consistent with the rows."""
_NO_COLUMNS = ("names", "max_versions", "current")
_TICK_S = 1e-6


class VersionRepository(Repository):
    """Versions; each method is one transaction and may raise `DatabaseError`.

    Steps raise `ConflictError` if a version other than `expected` ("": any) is current, or there is none to step to,
    and `NotFoundError` if the scene was deleted.
    """

    def of(self, scene: SceneRecord) -> Sequence[VersionRecord]:
        """Lists all versions of a READY scene, oldest first."""
        with self._reading() as connection:
            return tuple(versions_of(connection, scene.id).values()) or (trained_version(scene),)

    def known(self, scene_id: str, version: str) -> bool:
        """True if the version has a row, unlike the only one of an unedited scene."""
        with self._reading() as connection:
            return _exists(connection, scene_id, version)

    def without_row(self, versions: Collection[tuple[str, str]]) -> frozenset[tuple[str, str]]:
        """Filters (scene id, version) of existing scenes to those without row that are not current."""
        with self._reading() as connection:
            current = {tuple(row) for row in connection.execute(select(scenes.c.id, scenes.c.version))}
            rows = {tuple(row) for row in connection.execute(select(_ROWS.scene_id, _ROWS.version))}
        scene_ids = {scene_id for scene_id, _ in current}
        return frozenset(key for key in versions if key[0] in scene_ids) - current - rows

    def is_published(self, scene_id: str, version: str) -> bool:
        """Like `known`, but waits for transactions that may still publish the version."""
        with self._writing() as connection:
            connection.execute(select(scenes.c.id).where(scenes.c.id == scene_id).with_for_update())
            return _exists(connection, scene_id, version)

    def made_by(self, scene_id: str, request_id: str, digest: str) -> VersionRecord | None:
        """Returns the version made by a request id, or None; other edits raise `ConflictError`."""
        if not request_id:
            return None
        with self._reading() as connection:
            here = _ALL.where(_ROWS.scene_id == scene_id, _ROWS.request_id == request_id)
            row = requested_before(connection, here, request_id, digest, "edits")
        return None if row is None else VersionRecord(**row)

    def publish(self, new: NewVersion) -> tuple[VersionRecord, Sequence[str]]:
        """Makes a version current if its parent still is.

        Returns:
            The version, and the names of removed ones, whose folders the caller removes.

        Raises:
            ConflictError: the scene has another current version, or the request id made one meanwhile.
            NotFoundError: the scene was deleted.
        """
        try:
            with self._writing() as connection:
                return publish_within(connection, new)
        except IntegrityError as error:
            raise ConflictError(
                f"request id {new.request_id!r} has made a version meanwhile", field="request_id"
            ) from error

    def step_back(self, scene_id: str, expected: str = "") -> VersionRecord:
        """Makes the parent of the current version current and returns it."""
        with self._writing() as connection:
            scene = locked_scene(connection, scene_id, expected)
            records = versions_of(connection, scene_id)
            current = records.get(scene.version)
            if current is None or not current.parent:
                raise ConflictError("there is nothing to undo: this is the scene as it was trained", field="version")
            require(f"version {scene.version} of scene {scene_id}", parent=current.parent in records)
            parent = records[current.parent]
            _point(connection, scene, parent)
        return replace(parent, current=True)

    def step_forward(self, scene_id: str, expected: str = "") -> VersionRecord:
        """Makes the most recently current child of the current version current; returns it."""
        with self._writing() as connection:
            scene = locked_scene(connection, scene_id, expected)
            records = [child for child in versions_of(connection, scene_id).values() if child.parent == scene.version]
            if not records:
                raise ConflictError(
                    "there is nothing to redo: no version was made of the current one",
                    field="version",
                    hint="Look at the list of versions; any of them can be restored.",
                )
            last = max(records, key=lambda record: (record.current_at or 0.0, record.number))
            _point(connection, scene, last)
        return replace(last, current=True)

    def restore(self, scene_id: str, version: str, expected: str = "") -> VersionRecord:
        """Makes a version current and returns it; raises `NotFoundError` if it is unknown."""
        with self._writing() as connection:
            scene = locked_scene(connection, scene_id, expected)
            if version == scene.version:  # a scene that was never edited has no rows
                return versions_of(connection, scene_id).get(version) or trained_version(scene)
            record = versions_of(connection, scene_id).get(version)
            if record is None:
                raise NotFoundError(
                    f"no version {version[:80]!r} of this scene", field="version", hint="List the scene's versions."
                )
            _point(connection, scene, record)
        return replace(record, current=True)


def publish_within(connection: Connection, new: NewVersion) -> tuple[VersionRecord, Sequence[str]]:
    """Publishes a version as `VersionRepository.publish`, within a transaction without locked scenes."""
    scene = locked_scene(connection, new.scene_id, new.parent)
    records = versions_of(connection, scene.id)
    if not records:
        records = {scene.version: trained_version(scene)}
        connection.execute(insert(scene_versions).values(version_row(records[scene.version])))
    new = replace(
        new,
        scaling=new.scaling or scene.scaling,
        alignment=new.alignment or scene.alignment,
        quality={**scene.quality, **new.quality},
    )
    values = {
        **version_row(new), "request_id": new.request_id or None, "created_at": time.time(),
        "number": max(record.number for record in records.values()) + 1,
    }  # fmt: skip
    connection.execute(insert(scene_versions).values(values))
    _point(connection, scene, new)
    record_names(connection, scene.id, new.parent, new.version, new.names)
    removed = () if new.max_versions is None else _prune(connection, scene.id, new.version, new.max_versions)
    return versions_of(connection, scene.id)[new.version], removed


def _prune(connection: Connection, scene_id: str, new: str, limit: int) -> Sequence[str]:
    """Deletes the rows of versions beyond `limit` as `NewVersion` says; returns their names."""
    records = versions_of(connection, scene_id)
    in_force: set[str] = set()  # the current version and its ancestors
    version = next((record.version for record in records.values() if record.current), "")
    while version in records and version not in in_force:
        in_force.add(version)
        version = records[version].parent
    staying = {new, next(iter(records)), *(record.version for record in records.values() if record.current)}
    candidates = [record for record in records.values() if record.version not in staying]
    candidates.sort(key=lambda record: (record.version in in_force, record.number))
    removed = {record.version for record in candidates[: max(0, len(records) - limit)]}
    for record in records.values():
        parent = record.parent
        while parent in removed:
            parent = records[parent].parent
        here = (_ROWS.scene_id == scene_id, _ROWS.version == record.version)
        if record.version in removed:
            connection.execute(delete(scene_versions).where(*here))
            forget_names(connection, scene_id, record.version)
        elif parent != record.parent:
            connection.execute(update(scene_versions).where(*here).values(parent=parent))
    return sorted(removed)


def locked_scene(connection: Connection, scene_id: str, expected: str) -> SceneRecord:
    """Locks a scene's row and returns it, if its current version is `expected`.

    SQLite has no row locks; its writing transactions exclude each other. Errors are as in `VersionRepository.restore`.
    """
    row = connection.execute(select(scenes).where(scenes.c.id == scene_id).with_for_update()).mappings().first()
    if row is None:
        raise no_scene(scene_id)
    scene = SceneRecord(**row)
    if expected and scene.version != expected:
        raise ConflictError(
            f"the current version of scene {scene_id!r} is {scene.version!r}, not {expected[:80]!r}",
            field="version",
            hint="Look at the scene as it is now, then decide again.",
        )
    return scene


def _point(connection: Connection, scene: SceneRecord, to: NewVersion | VersionRecord) -> None:
    """Makes a version the current one of a locked scene."""
    values = {
        "version": to.version, "gaussians": to.gaussians, "dictionary": [dict(row) for row in to.dictionary],
        "scaling": None if to.scaling is None else dict(to.scaling),
        "alignment": None if to.alignment is None else dict(to.alignment), "objects": to.objects,
        "quality": dict(to.quality),
    }  # fmt: skip
    connection.execute(update(scenes).where(scenes.c.id == scene.id).values(values))
    # Increases whatever the clocks of several machines say, so that a redo finds what an undo left.
    latest = connection.scalar(select(func.max(_ROWS.current_at)).where(_ROWS.scene_id == scene.id))
    left = update(scene_versions).where(_ROWS.scene_id == scene.id, _ROWS.version == scene.version)
    connection.execute(left.values(current_at=max(time.time(), (latest or 0.0) + _TICK_S)))


def versions_of(connection: Connection, scene_id: str) -> dict[str, VersionRecord]:
    """Maps version names to rows, oldest first; empty if the scene was never edited."""
    rows = connection.execute(_ALL.where(_ROWS.scene_id == scene_id).order_by(_ROWS.number))
    return {row["version"]: VersionRecord(**row) for row in rows.mappings()}


def _exists(connection: Connection, scene_id: str, version: str) -> bool:
    here = select(exists().where(_ROWS.scene_id == scene_id, _ROWS.version == version))
    return bool(connection.scalar(here))


def version_row(version: NewVersion | VersionRecord) -> dict[str, Any]:
    return {name: value for name, value in vars(version).items() if name not in _NO_COLUMNS}


def trained_version(scene: SceneRecord) -> VersionRecord:
    return VersionRecord(
        scene.id, scene.version, 1, "", scene.created_at, None, "", scene.gaussians, scene.dictionary, (),
        scene.quality, scene.objects, current=True,
    )  # fmt: skip
