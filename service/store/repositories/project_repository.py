"""Projects in the database; every scene, operation, request id and key belongs to one."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import exists, func, insert, select, update
from sqlalchemy.exc import IntegrityError

from fastsplat.service.store.rows.database import Repository
from fastsplat.service.store.rows.schema import api_keys, projects, scenes
from fastsplat_contract.errors import ConflictError


@dataclass(frozen=True)
class ProjectRecord:
    """A project; `created_at` is seconds since 1970, UTC, `keys` counts revoked and expired ones, too."""

    name: str
    created_at: float
    scenes: int
    keys: int


class ProjectRepository(Repository):
    """Projects; each method is one transaction and may raise `DatabaseError`."""

    def add(self, name: str) -> None:
        """Inserts a project; raises `ConflictError` if the name is taken."""
        try:
            with self._writing() as connection:
                connection.execute(insert(projects).values(name=name, created_at=time.time()))
        except IntegrityError:
            raise ConflictError(f"there is a project {name!r} already", field="project") from None

    def exists(self, name: str) -> bool:
        with self._reading() as connection:
            return bool(connection.scalar(select(exists().where(projects.c.name == name))))

    def names(self) -> Sequence[str]:
        with self._reading() as connection:
            return list(connection.scalars(select(projects.c.name)))

    def agree(self, name: str, captioner_host: str) -> None:
        """Sets the host whose naming service may receive the project's pictures; "": none."""
        with self._writing() as connection:
            connection.execute(update(projects).where(projects.c.name == name).values(captioner_host=captioner_host))

    def agreed(self, name: str) -> str:
        """Returns the host set by `agree`; "": none."""
        with self._reading() as connection:
            return str(connection.scalar(select(projects.c.captioner_host).where(projects.c.name == name)) or "")

    def all(self) -> Sequence[ProjectRecord]:
        """Lists all projects by name."""
        counts = [
            select(func.count()).where(table.c.project == projects.c.name).scalar_subquery()
            for table in (scenes, api_keys)
        ]
        query = select(projects.c.name, projects.c.created_at, *counts).order_by(projects.c.name)
        with self._reading() as connection:
            return [ProjectRecord(*row) for row in connection.execute(query)]
