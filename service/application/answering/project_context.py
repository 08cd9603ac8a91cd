"""What all calls of one project share."""

from __future__ import annotations

from dataclasses import dataclass, replace

from fastsplat.service.application.admin.project_names import KnownNames
from fastsplat.service.application.admin.quotas import Quotas
from fastsplat.service.application.answering.open_scenes import OpenScenes
from fastsplat.service.application.base.memory import MemoryBudget
from fastsplat.service.jobs.needed_models import in_use
from fastsplat.service.settings import Settings
from fastsplat.service.store.store import Store


@dataclass(frozen=True)
class ProjectContext:
    """Store, caches and limits for the calls of one project."""

    store: Store  # of the project, or of one of its scenes alone
    settings: Settings
    memory: MemoryBudget  # of all projects
    scenes: OpenScenes
    known_names: KnownNames
    quotas: Quotas

    @property
    def settings_in_use(self) -> Settings:
        """The settings with the models that are chosen now."""
        return in_use(self.settings, self.store.models.chosen())

    @property
    def project(self) -> str:
        return self.store.project

    def over(self, store: Store) -> ProjectContext:
        """Returns the context of another view of the store, with the same caches and limits."""
        return replace(self, store=store, scenes=self.scenes.over(store), known_names=self.known_names.over(store))
