"""Projects as tenants: what is in one does not exist for the keys of another. Nothing moves between them."""

from __future__ import annotations

import re

from fastsplat.service.store.project_repository import ProjectRecord, ProjectRepository
from fastsplat_contract.errors import InvalidInputError

_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,62}")


class Projects:
    """The projects of one database."""

    def __init__(self, rows: ProjectRepository) -> None:
        self._rows = rows

    def create(self, name: str) -> None:
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

    def all(self) -> tuple[ProjectRecord, ...]:
        """Every project by name."""
        return tuple(self._rows.all())

    def exists(self, name: str) -> bool:
        """Whether there is a project of that name."""
        return self._rows.exists(name)
