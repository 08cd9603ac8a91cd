"""Projects as tenants: what is in one does not exist for the keys of another. Nothing moves between them."""

from __future__ import annotations

import re
from datetime import UTC, datetime

from fastsplat.service.store.project_repository import ProjectRepository
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.operating_messages import Project, ProjectList

_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,62}")


class Projects:
    """The projects of one database."""

    def __init__(self, rows: ProjectRepository) -> None:
        self._rows = rows

    def create(self, name: str) -> Project:
        """Make a project, empty and without keys.

        Raises:
            InvalidInputError: an unusable name.
            ConflictError: there is one of that name.
        """
        if not _NAME.fullmatch(name):
            raise InvalidInputError(
                f"{name[:80]!r} cannot name a project",
                field="project",
                hint="Use 1 to 63 lower-case letters, digits and hyphens, no hyphen first.",
            )
        self._rows.add(name)
        return next(project for project in self.all().projects if project.name == name)

    def all(self) -> ProjectList:
        """Every project, by name."""
        rows = self._rows.all()
        return ProjectList(
            tuple(Project(row.name, datetime.fromtimestamp(row.created_at, UTC), row.scenes, row.keys) for row in rows)
        )

    def exists(self, name: str) -> bool:
        """Whether there is a project of that name."""
        return self._rows.exists(name)
