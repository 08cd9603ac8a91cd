"""Administration of a service: keys, metrics, readiness."""

from __future__ import annotations

import tempfile
from collections.abc import Callable

from sqlalchemy import text

from fastsplat.service.application.admin.keys import Keys
from fastsplat.service.application.admin.projects import Projects
from fastsplat.service.application.admin.service_metrics import ServiceMetrics
from fastsplat.service.settings import Settings
from fastsplat.service.store.database import transaction
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import ModelUnavailableError, ResourceError


class Admin:
    """Administration of one service, for its operators.

    Attributes:
        keys: who may call.
        projects: whose scenes are apart from each other.
        metrics: of jobs and scenes.
    """

    def __init__(self, store: Store, settings: Settings, open_scenes: Callable[[], int]) -> None:
        self._store = store
        self._settings = settings
        self.keys = Keys(store.keys, store.projects)
        self.projects = Projects(store.projects)
        self.metrics = ServiceMetrics(store.job_metrics, open_scenes)

    def check_ready(self) -> None:
        """Return if a request could be answered now.

        Raises:
            DatabaseError: the database does not answer.
            ResourceError: the data folder cannot be written.
            ModelUnavailableError: the text encoder is not in the model directory.
        """
        with transaction(self._store.engine.execution_options(read_only=True)) as connection:
            connection.execute(text("SELECT 1"))
        self._check_folder()
        self._check_models()

    def _check_folder(self) -> None:
        try:
            with tempfile.TemporaryFile(dir=self._store.blobs.root) as probe:
                probe.write(b"\0")
        except OSError as error:
            raise ResourceError(
                f"the data folder cannot be written: {error.strerror}",
                field="data_dir",
                hint="Free space, or make the folder writable for the service.",
            ) from error

    def _check_models(self) -> None:
        from fastsplat.service.perception.models.model_manifest import find_model

        name = self._settings.perception.text_encoder
        _, inside = find_model(name, "text_encoder")
        folder = self._settings.models / inside
        if not folder.is_dir() or not any(folder.iterdir()):
            raise ModelUnavailableError(
                f"text encoder {name} is not in the model directory", field="models", hint="Run: fastsplat models pull"
            )
