"""Known names: names that people gave to objects of a project's scenes, with their appearance.

Every version of a scene has its rows, and those of the current version count: undoing, unnaming and deleting a scene
take names back without further steps.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from sqlalchemy import ColumnElement, Connection, Engine, RowMapping, and_, delete, insert, literal, select, tuple_

from fastsplat.service.scene.artefact.reads import tags_of
from fastsplat.service.store.rows.database import Repository
from fastsplat.service.store.rows.schema import known_names, scenes
from fastsplat_contract.errors import NotFoundError

if TYPE_CHECKING:
    from fastsplat.service.scene.artefact.scene import Objects


Said = tuple[str, float, bool]
"""An earlier suggestion of a name for the object, see `SaidName`."""


@dataclass(frozen=True)
class NewName:
    """A name given by a person in a new version; other fields as in `Object`."""

    object_id: int
    name: str
    appearance: bytes = field(repr=False)
    picture: bytes = field(repr=False)
    said: Sequence[Said] = ()
    tags: Sequence[tuple[str, float]] = ()


@dataclass(frozen=True)
class VersionNames:
    """The names of a new version of a scene."""

    given: Sequence[NewName] = ()  # by the version's edits
    unchanged: Sequence[int] = ()  # ids of objects that keep their name; one forgotten meanwhile stays forgotten
    limit: int = 0  # of names kept in the project, the newest ones


@dataclass(frozen=True)
class KnownNameRecord:
    """A name that counts; `named_at` is seconds since 1970, UTC, `picture` empty unless requested."""

    id: str
    scene_id: str
    version: str
    object_id: int
    name: str
    named_at: float
    appearance: bytes = field(repr=False)
    picture: bytes = field(default=b"", repr=False)
    said: Sequence[Said] = ()
    tags: Sequence[tuple[str, float]] = ()


def names_between(
    before: Objects | None, after: Objects | None, appearances: Mapping[int, bytes], limit: int
) -> VersionNames:
    """Finds the names given and kept by a version.

    Objects with neither appearance nor tag are left out.

    Args:
        before, after: objects of the previous version and of this one.
        appearances: by object id, for recognition in other scenes; see `described`.
    """
    known = {obj.id: obj.name for obj in before.table if obj.source == "person"} if before else {}
    by_person = [obj for obj in after.table if obj.source == "person"] if after else []
    named = [obj for obj in by_person if obj.appearance or tags_of(obj.reads)]
    unchanged = [obj.id for obj in named if known.get(obj.id) == obj.name]
    given = [
        NewName(
            obj.id, obj.name, appearances.get(obj.id, b""), obj.picture, obj.said, tuple(tags_of(obj.reads).items())
        )
        for obj in named
        if known.get(obj.id) != obj.name
    ]
    return VersionNames(given, unchanged, limit)


_ROWS = known_names.c
_PLAIN = [column for column in _ROWS if column.name != "picture"]
_NEWEST_FIRST = _ROWS.named_at.desc(), _ROWS.id.desc()
_OF_CURRENT = and_(scenes.c.id == _ROWS.scene_id, scenes.c.version == _ROWS.version)


def record_names(connection: Connection, scene_id: str, parent: str, version: str, names: VersionNames) -> None:
    """Writes the names of a version in the transaction that makes it current."""
    now = time.time()
    if names.unchanged:
        columns = [literal(version) if column is _ROWS.version else column for column in _ROWS]
        of_parent = select(*columns).where(
            _ROWS.scene_id == scene_id, _ROWS.version == parent, _ROWS.object_id.in_(names.unchanged)
        )
        connection.execute(insert(known_names).from_select([column.name for column in _ROWS], of_parent))
    for given in names.given:
        row = {"id": f"{scene_id}-{given.object_id}", "scene_id": scene_id, "version": version, "named_at": now}
        connection.execute(insert(known_names).values(**row, **vars(given)))
    if names.given:
        _leave(connection, scene_id, names.limit)


def forget_names(connection: Connection, scene_id: str, version: str | None = None) -> None:
    """Deletes the names of a version of a scene; None: of all versions."""
    of_version = () if version is None else (_ROWS.version == version,)
    connection.execute(delete(known_names).where(_ROWS.scene_id == scene_id, *of_version))


class KnownNameRepository(Repository):
    """Known names of a project; each method is one transaction and may raise `DatabaseError`."""

    def __init__(self, engine: Engine, project: str | None = None) -> None:
        super().__init__(engine)
        self._project = project

    def keys(self) -> Sequence[tuple[str, str]]:
        """Lists (id, version) of all names that count.

        Rows never change: while these keys are the same, so is the result of `all`.
        """
        query = select(_ROWS.id, _ROWS.version).join(scenes, _OF_CURRENT).where(self._within()).order_by(_ROWS.id)
        with self._reading() as connection:
            return [(scene_id, version) for scene_id, version in connection.execute(query)]

    def all(self) -> Sequence[KnownNameRecord]:
        """Lists all names that count, newest first, without pictures."""
        query = select(*_PLAIN).join(scenes, _OF_CURRENT).where(self._within()).order_by(*_NEWEST_FIRST)
        with self._reading() as connection:
            return [_record(row) for row in connection.execute(query).mappings()]

    def page(self, limit: int, after: tuple[float, str] | None = None) -> Sequence[KnownNameRecord]:
        """Lists names that count, newest first, after (named_at, id)."""
        query = select(*_ROWS).join(scenes, _OF_CURRENT).where(self._within())
        if after is not None:
            query = query.where(tuple_(_ROWS.named_at, _ROWS.id) < after)
        with self._reading() as connection:
            rows = connection.execute(query.order_by(*_NEWEST_FIRST).limit(limit))
            return [_record(row) for row in rows.mappings()]

    def forget(self, name_id: str | None) -> None:
        """Deletes a name (unknown: `NotFoundError`), or all of the project; scenes keep theirs."""
        mine = _ROWS.scene_id.in_(select(scenes.c.id).where(self._within()))
        of_id = () if name_id is None else (_ROWS.id == name_id,)
        with self._writing() as connection:
            if not connection.execute(delete(known_names).where(mine, *of_id)).rowcount and name_id is not None:
                raise NotFoundError(
                    f"no known name {name_id[:80]!r}", field="name_id", hint="List the known names to see which are."
                )

    def _within(self) -> ColumnElement[bool]:
        return literal(True) if self._project is None else scenes.c.project == self._project


def _record(row: RowMapping) -> KnownNameRecord:
    return KnownNameRecord(**{**row, **{name: tuple(map(tuple, row[name])) for name in ("said", "tags")}})


def _leave(connection: Connection, scene_id: str, limit: int) -> None:
    """Deletes all but the newest `limit` names of the scene's project."""
    project = connection.scalar(select(scenes.c.project).where(scenes.c.id == scene_id))
    newest = select(_ROWS.named_at).join(scenes, _OF_CURRENT).where(scenes.c.project == project)
    oldest = connection.scalar(newest.order_by(_ROWS.named_at.desc()).offset(limit - 1).limit(1))
    if oldest is not None:
        mine = _ROWS.scene_id.in_(select(scenes.c.id).where(scenes.c.project == project))
        connection.execute(delete(known_names).where(mine, _ROWS.named_at < oldest))
