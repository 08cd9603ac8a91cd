"""Administration of a service: keys, metrics, readiness."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from datetime import UTC, datetime

from sqlalchemy import text

from fastsplat.service.application.admin.keys import Keys
from fastsplat.service.application.admin.service_metrics import ServiceMetrics
from fastsplat.service.jobs.needed_models import in_use
from fastsplat.service.settings import Settings
from fastsplat.service.store.repositories.project_repository import ProjectRepository
from fastsplat.service.store.rows.database import transaction
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError, ResourceError
from fastsplat_contract.messages.projects import Project, ProjectList

_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,62}")


class Admin:
    """Administration of one service: keys, projects, metrics and readiness."""

    def __init__(self, store: Store, settings: Settings, open_scenes: Callable[[], int]) -> None:
        self._store = store
        self._settings = settings
        self.keys = Keys(store.keys, store.projects)
        self.projects = Projects(store.projects)
        self.metrics = ServiceMetrics(store.jobs, open_scenes)

    @property
    def settings_in_use(self) -> Settings:
        """The settings with the models that are chosen now."""
        return in_use(self._settings, self._store.models.chosen())

    def check_ready(self) -> None:
        """Checks that a request could be answered now.

        Raises:
            DatabaseError: the database does not answer.
            ResourceError: the data folder is not writable.
            ModelUnavailableError: the text encoder is missing.
        """
        with transaction(self._store.engine.execution_options(read_only=True)) as connection:
            connection.execute(text("SELECT 1"))
        try:
            with tempfile.TemporaryFile(dir=self._store.blobs.root) as probe:
                probe.write(b"\0")
        except OSError as error:
            raise ResourceError(
                f"the data folder cannot be written: {error.strerror}",
                field="data_dir",
                hint="Free space, or make the folder writable for the service.",
            ) from error
        self._check_models()

    def _check_models(self) -> None:
        from fastsplat.service.perception.models.model_manifest import has_files

        name = self.settings_in_use.perception.text_encoder
        if not has_files(name, "text_encoder", self._settings.models):
            raise ModelUnavailableError(
                f"text encoder {name} is not in the model directory", field="models", hint="Run: fastsplat models pull"
            )


class Projects:
    """The projects of one database."""

    def __init__(self, rows: ProjectRepository) -> None:
        self._rows = rows

    def create(self, name: str) -> Project:
        """Creates an empty project; raises `ConflictError` for a taken, `InvalidInputError` for an unusable name."""
        if not _NAME.fullmatch(name):
            raise InvalidInputError(
                f"{name[:80]!r} cannot name a project",
                field="project",
                hint="Use 1 to 63 lower-case letters, digits and hyphens, no hyphen first.",
            )
        self._rows.add(name)
        return next(project for project in self.all().projects if project.name == name)

    def all(self) -> ProjectList:
        """Lists all projects by name."""
        rows = self._rows.all()
        return ProjectList(
            tuple(Project(row.name, datetime.fromtimestamp(row.created_at, UTC), row.scenes, row.keys) for row in rows)
        )

    def exists(self, name: str) -> bool:
        return self._rows.exists(name)
