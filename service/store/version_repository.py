"""Scene versions in the database: which there are, what they were made of, and which one is current.

A scene without rows here was never edited: its trained version is the only one.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from sqlalchemy import Connection, Engine, delete, exists, func, insert, select, update
from sqlalchemy.exc import IntegrityError

from fastsplat.service.store.damaged_rows import are_objects, is_name, is_object, is_time, require
from fastsplat.service.store.database import transaction
from fastsplat.service.store.name_repository import VersionNames, forget_names, record_names
from fastsplat.service.store.records import SceneRecord
from fastsplat.service.store.scene_repository import no_scene
from fastsplat.service.store.schema import scene_versions, scenes
from fastsplat_contract.errors import ConflictError, NotFoundError


@dataclass(frozen=True)
class VersionRecord:
    """One version. `number` counts from 1, the trained one; `edits`, `scaling`, `alignment` and `quality` are JSON as
    the service layer wrote them. `current_at` is when it last became current again, None if it never did. `author`
    names the key that made it.
    """

    scene_id: str
    version: str
    number: int
    parent: str
    created_at: float
    request_id: str | None
    request_digest: str
    gaussians: int
    dictionary: Sequence[Mapping[str, Any]]
    edits: Sequence[Mapping[str, Any]]
    current_at: float | None = None
    author: str = ""
    scaling: Mapping[str, Any] | None = None
    alignment: Mapping[str, Any] | None = None
    quality: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        require(
            f"version {self.version} of scene {self.scene_id}",
            version=is_name(self.version),
            number=isinstance(self.number, int),
            parent=isinstance(self.parent, str),
            created_at=is_time(self.created_at),
            gaussians=isinstance(self.gaussians, int),
            dictionary=are_objects(self.dictionary, "label_id", "label"),
            edits=are_objects(self.edits),
            current_at=self.current_at is None or is_time(self.current_at),
            scaling=self.scaling is None or is_object(self.scaling),
            alignment=self.alignment is None or is_object(self.alignment),
            quality=self.quality is None or is_object(self.quality),
        )


@dataclass(frozen=True)
class NewVersion:
    """A version whose folder is in place, to become the current one; without a `scaling`, an `alignment` or a `quality`
    it has its parent's.

    One that is `beside` the current version, and made of another one, does not become the current one.
    """

    scene_id: str
    version: str
    parent: str
    request_id: str
    request_digest: str
    gaussians: int
    dictionary: Sequence[Mapping[str, Any]]
    edits: Sequence[Mapping[str, Any]]
    names: VersionNames = field(default_factory=VersionNames)
    author: str = ""
    scaling: Mapping[str, Any] | None = None
    alignment: Mapping[str, Any] | None = None
    quality: Mapping[str, Any] | None = None
    beside: bool = False


class VersionRepository:
    """Versions in the database; every method is one transaction. All raise `DatabaseError` when it is away."""

    def __init__(self, engine: Engine) -> None:
        self._writing = partial(transaction, engine)
        self._reading = partial(transaction, engine.execution_options(read_only=True))

    def of(self, scene: SceneRecord) -> Sequence[VersionRecord]:
        """Every version of a READY scene, oldest first."""
        query = select(scene_versions).where(scene_versions.c.scene_id == scene.id).order_by(scene_versions.c.number)
        with self._reading() as connection:
            records = [VersionRecord(**row) for row in connection.execute(query).mappings()]
        return records or [_trained(scene)]

    def known(self, scene_id: str, version: str) -> bool:
        """Whether there is a row of that version (the only version of a scene that was never edited has none)."""
        here = select(exists().where(scene_versions.c.scene_id == scene_id, scene_versions.c.version == version))
        with self._reading() as connection:
            return bool(connection.scalar(here))

    def made_by(self, scene_id: str, request_id: str, digest: str) -> VersionRecord | None:
        """The version that this request id made before, or None.

        Raises:
            ConflictError: it was made by other edits.
        """
        if not request_id:
            return None
        here = select(scene_versions).where(
            scene_versions.c.scene_id == scene_id, scene_versions.c.request_id == request_id
        )
        with self._reading() as connection:
            row = connection.execute(here).mappings().first()
        if row is None:
            return None
        if row["request_digest"] != digest:
            raise ConflictError(
                f"request id {request_id!r} was used before, for other edits",
                field="request_id",
                hint="Send the very same edits again, or choose a new request id.",
            )
        return VersionRecord(**row)

    def publish(self, new: NewVersion) -> None:
        """Make a version current, if its parent still is.

        Raises:
            ConflictError: the scene has another current version by now, or the request id made one meanwhile.
            NotFoundError: the scene was deleted.
        """
        try:
            self._publish(new)
        except IntegrityError as error:
            raise ConflictError(
                f"request id {new.request_id!r} has made a version meanwhile", field="request_id"
            ) from error

    def _publish(self, new: NewVersion) -> None:
        with self._writing() as connection:
            publish_within(connection, new)

    def prune(self, scene_id: str, limit: int) -> Sequence[str]:
        """Delete the rows of versions beyond `limit`; returns their names, whose folders are the caller's to remove.

        Undone versions go first, then the oldest. The current version and the trained one stay; what was made of a
        deleted version is undone to the one before that.
        """
        with self._writing() as connection:
            current = connection.scalar(select(scenes.c.version).where(scenes.c.id == scene_id))
            query = select(scene_versions).where(scene_versions.c.scene_id == scene_id)
            rows = connection.execute(query.order_by(scene_versions.c.number)).mappings()
            records = {row["version"]: VersionRecord(**row) for row in rows}
            in_force = _lineage(records, current or "")
            candidates = [record for record in records.values() if record.parent and record.version != current]
            candidates.sort(key=lambda record: (record.version in in_force, record.number))
            removed = {record.version for record in candidates[: max(0, len(records) - limit)]}
            for record in records.values():
                parent = record.parent
                while parent in removed:
                    parent = records[parent].parent
                here = (scene_versions.c.scene_id == scene_id, scene_versions.c.version == record.version)
                if record.version in removed:
                    connection.execute(delete(scene_versions).where(*here))
                    forget_names(connection, scene_id, record.version)
                elif parent != record.parent:
                    connection.execute(update(scene_versions).where(*here).values(parent=parent))
        return sorted(removed)

    def step_back(self, scene_id: str, expected: str) -> None:
        """Make the parent of the current version current.

        Raises:
            ConflictError: `expected` is not the current version (any more), or it is the trained one.
            NotFoundError: the scene was deleted.
        """
        with self._writing() as connection:
            _ready(connection, scene_id, expected=expected)
            parents = select(scene_versions).where(scene_versions.c.scene_id == scene_id)
            by_version = {row["version"]: VersionRecord(**row) for row in connection.execute(parents).mappings()}
            current = by_version.get(expected)
            if current is None or not current.parent:
                raise ConflictError("there is nothing to undo: this is the scene as it was trained", field="version")
            require(f"version {expected} of scene {scene_id}", parent=current.parent in by_version)
            _point(connection, scene_id, by_version[current.parent])

    def step_forward(self, scene_id: str, expected: str) -> None:
        """Make a version current that was made of the current one: of several the one that was current last.

        Raises:
            ConflictError: `expected` is not the current version (any more), or none was made of it.
            NotFoundError: the scene was deleted.
        """
        children = select(scene_versions).where(
            scene_versions.c.scene_id == scene_id, scene_versions.c.parent == expected
        )
        with self._writing() as connection:
            _ready(connection, scene_id, expected=expected)
            records = [VersionRecord(**row) for row in connection.execute(children).mappings()]
            if not records:
                raise ConflictError(
                    "there is nothing to redo: no version was made of the current one",
                    field="version",
                    hint="Look at the list of versions; any of them can be restored.",
                )
            last = max(records, key=lambda record: (record.current_at or record.created_at, record.number))
            _point(connection, scene_id, last)

    def restore(self, scene_id: str, version: str, expected: str) -> None:
        """Make a version current, wherever it is in the tree of versions.

        Raises:
            ConflictError: `expected` is not the current version (any more).
            NotFoundError: the scene was deleted, or has no such version.
        """
        here = select(scene_versions).where(scene_versions.c.scene_id == scene_id, scene_versions.c.version == version)
        with self._writing() as connection:
            _ready(connection, scene_id, expected=expected)
            row = connection.execute(here).mappings().first()
            if row is not None:
                _point(connection, scene_id, VersionRecord(**row))
            elif version != expected:  # a scene that was never edited has no rows
                raise no_version(version)

    def forget(self, scene_id: str) -> None:
        """Remove the versions of a scene that is gone."""
        with self._writing() as connection:
            connection.execute(delete(scene_versions).where(scene_versions.c.scene_id == scene_id))
            forget_names(connection, scene_id)


def publish_within(connection: Connection, new: NewVersion) -> None:
    """As `VersionRepository.publish`, as a part of somebody's transaction.

    Raises:
        ConflictError: the scene has another current version by now.
        NotFoundError: the scene was deleted.
    """
    scene = _ready(connection, new.scene_id, expected=None if new.beside else new.parent)
    here = scene_versions.c.scene_id == new.scene_id
    count = connection.scalar(select(func.count()).select_from(scene_versions).where(here))
    # Rows of before versions had a quality of their own: then that of the scene is that of all of them.
    unsaid = update(scene_versions).where(here, scene_versions.c.quality.is_(None))
    connection.execute(unsaid.values(quality=dict(scene.quality)))
    if not count:
        first = vars(_trained(scene))
        connection.execute(insert(scene_versions).values(first))
    parent: SceneRecord | VersionRecord = scene
    if new.beside:
        row = connection.execute(select(scene_versions).where(here, scene_versions.c.version == new.parent)).mappings()
        origin = row.first()
        if origin is None:
            raise no_version(new.parent)
        parent = VersionRecord(**origin)
    new = replace(
        new,
        scaling=new.scaling or parent.scaling,
        alignment=new.alignment or parent.alignment,
        quality=new.quality or parent.quality,
    )
    columns = {name: value for name, value in vars(new).items() if name not in ("names", "beside")}
    values = {**columns, "request_id": new.request_id or None, "number": (count or 1) + 1}
    connection.execute(insert(scene_versions).values(**values, created_at=time.time()))
    if not new.beside:
        _point(connection, new.scene_id, new)
    record_names(connection, new.scene_id, new.parent, new.version, new.names)


def _lineage(records: Mapping[str, VersionRecord], version: str) -> frozenset[str]:
    """A version and all that it was made of."""
    names: set[str] = set()
    while version in records and version not in names:
        names.add(version)
        version = records[version].parent
    return frozenset(names)


def _ready(connection: Connection, scene_id: str, expected: str | None) -> SceneRecord:
    row = connection.execute(select(scenes).where(scenes.c.id == scene_id)).mappings().first()
    if row is None:
        raise no_scene(scene_id)
    scene = SceneRecord(**row)
    if expected is not None and scene.version != expected:
        raise ConflictError(
            f"the current version of scene {scene_id!r} is {scene.version!r}, not {expected[:80]!r}",
            field="version",
            hint="Look at the scene as it is now, then decide again.",
        )
    return scene


def _point(connection: Connection, scene_id: str, to: NewVersion | VersionRecord) -> None:
    values = {
        "version": to.version, "gaussians": to.gaussians, "dictionary": [dict(row) for row in to.dictionary],
        "scaling": None if to.scaling is None else dict(to.scaling),
        "alignment": None if to.alignment is None else dict(to.alignment),
        **({} if to.quality is None else {"quality": dict(to.quality)}),
    }  # fmt: skip
    connection.execute(update(scenes).where(scenes.c.id == scene_id).values(values))
    here = (scene_versions.c.scene_id == scene_id, scene_versions.c.version == to.version)
    connection.execute(update(scene_versions).where(*here).values(current_at=time.time()))


def no_version(version: str) -> NotFoundError:
    """The error for a version that a scene does not have."""
    return NotFoundError(
        f"no version {version[:80]!r} of this scene", field="version", hint="List the scene's versions."
    )


def _trained(scene: SceneRecord) -> VersionRecord:
    return VersionRecord(
        scene.id, scene.version, 1, "", scene.created_at, None, "", scene.gaussians, scene.dictionary, (),
        quality=scene.quality,
    )  # fmt: skip
