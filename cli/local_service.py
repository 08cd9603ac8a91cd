"""The service over the configured data folder, for commands that need no server."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from fastsplat.service.settings import load_settings
from fastsplat.service.store.records import DEFAULT_PROJECT

if TYPE_CHECKING:
    from fastsplat.service.application.service import SceneService


@contextmanager
def local_service(project: str) -> Iterator[SceneService]:
    """The service over the configured data folder, as a project has it."""
    from fastsplat.service.application.service import open_service  # loads what answers questions

    with open_service(load_settings()) as service:
        yield service if project == DEFAULT_PROJECT else service.in_project(project)
