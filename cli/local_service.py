"""The service and the store of the configured data folder, for commands that need no server."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from fastsplat.service.settings import load_settings
from fastsplat.service.store.records import DEFAULT_PROJECT

if TYPE_CHECKING:
    from fastsplat.service.application.service import SceneService
    from fastsplat.service.store.store import Store


@contextmanager
def local_service(project: str) -> Iterator[SceneService]:
    """The service over the configured data folder, as a project has it."""
    from fastsplat.service.application.service import open_service  # loads what answers questions

    with open_service(load_settings()) as service:
        yield service if project == DEFAULT_PROJECT else service.in_project(project)


@contextmanager
def local_store(*, adopting: bool = False) -> Iterator[Store]:
    """The store of the configured data folder; `adopting`: see `open_store`."""
    from fastsplat.service.store.store import open_store  # loads the database's library

    settings = load_settings()
    store = open_store(settings.data_dir, settings.database_url, settings.artefacts, adopting=adopting)
    try:
        yield store
    finally:
        store.close()
