"""Known names of one project: list, removal, and suggestions for similar objects."""

from __future__ import annotations

import copy
import threading
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime

from fastsplat.service.application.base.paging import read_page_token, write_page_token
from fastsplat.service.application.base.validate import check_page_size
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.objects.names.merged_suggestions import OWN_SOURCE, agreed
from fastsplat.service.query.objects.names.names_from_scenes import KnownObject, NameFromScene
from fastsplat.service.query.objects.object_index import listed_suggestions
from fastsplat.service.query.ranked_scene import RankedScene
from fastsplat.service.scene.artefact.reads import tags_of
from fastsplat.service.scene.artefact.suggestions import SaidName
from fastsplat.service.settings import Settings
from fastsplat.service.store.store import Store
from fastsplat_contract.messages.known_names import EVERY_NAME, KnownName, KnownNameList
from fastsplat_contract.messages.objects import NameSuggestion, SceneObject, SuggestionSource

_KEPT_PROJECTS = 64
"""Projects whose names are cached, at most 1 to 2 MB each."""


class KnownNames:
    """Names given in one project, invisible to others. Thread-safe."""

    def __init__(self, store: Store, settings: Settings) -> None:
        self._store = store
        self._settings = settings
        self._by_project: dict[str, tuple[Sequence[tuple[str, str]], Sequence[KnownObject]]] = {}
        self._lock = threading.Lock()

    def over(self, store: Store) -> KnownNames:
        """Same object and cache for another view of the store."""
        clone = copy.copy(self)
        clone._store = store
        return clone

    def list(self, page_size: int = 0, page_token: str = "") -> KnownNameList:
        """Lists names given by people, newest first, paged as `SceneService.list_scenes`."""
        size = check_page_size(page_size, self._settings.store)
        records = self._store.known_names.page(size + 1, read_page_token(page_token))
        more = len(records) > size
        token = write_page_token(records[size - 1].named_at, records[size - 1].id) if more else ""
        names = [
            KnownName(
                id=record.id,
                name=record.name,
                scene_id=record.scene_id,
                version=record.version,
                object_id=record.object_id,
                named_at=datetime.fromtimestamp(record.named_at, UTC),
                picture=record.picture,
            )
            for record in records[:size]
        ]
        return KnownNameList(tuple(names), token)

    def forget(self, name_id: str) -> None:
        """Stops suggesting a name (`EVERY_NAME`: all); scenes keep it. Raises `NotFoundError`."""
        forgotten = None if name_id == EVERY_NAME else name_id
        self._store.reserve.lend(lambda: self._store.known_names.forget(forgotten))

    def suggest(self, scene_id: str, ranked: RankedScene, listed: Sequence[SceneObject]) -> tuple[SceneObject, ...]:
        """Adds names from other scenes to the suggestions of listed objects."""
        weighed = self.suggesting(scene_id, ranked)
        if weighed is ranked:
            return tuple(listed)
        names, trust = weighed.elsewhere, weighed.names.trust
        if trust != ranked.names.trust:
            known = {obj.id: obj for obj in (*ranked.names.present, *ranked.names.parts)}
            listed = [
                replace(obj, suggestions=listed_suggestions(known[obj.id], trust)) if obj.id in known else obj
                for obj in listed
            ]
        return tuple(_suggested(obj, names[obj.id]) if obj.id in names else obj for obj in listed)

    def suggesting(self, scene_id: str, ranked: RankedScene) -> RankedScene:
        """Adds suggestions and source trust from other scenes, hidden from keys of one scene."""
        looks = any(obj.appearance or tags_of(obj.reads) for obj in ranked.names.present)
        if self._store.only_scene or not (looks or ranked.names.sources):
            return ranked
        return ranked.suggesting(self._known(), scene_id)

    def _known(self) -> Sequence[KnownObject]:
        """All names of the project; the same sequence until they change."""
        project = self._store.project
        keys, known = self._by_project.get(project, ((), ()))
        current = self._store.known_names.keys()
        if list(keys) != list(current):
            # Concurrent writes are picked up by the next query, as they change the keys.
            keys, records = current, self._store.known_names.all()
            known = tuple(
                KnownObject(
                    row.scene_id, row.name, row.appearance, tuple(SaidName(*said) for said in row.said),
                    tuple((tag, probability) for tag, probability in row.tags),
                )
                for row in records
            )  # fmt: skip
            with self._lock:
                self._by_project.pop(project, None)
                self._by_project[project] = keys, known
                while len(self._by_project) > _KEPT_PROJECTS:
                    del self._by_project[next(iter(self._by_project))]
        return known


def _suggested(obj: SceneObject, name: NameFromScene) -> SceneObject:
    if obj.name and label_key(obj.name) == label_key(name.name):
        return obj
    same = [suggestion for suggestion in obj.suggestions if label_key(suggestion.name) == label_key(name.name)]
    rest = [suggestion for suggestion in obj.suggestions if suggestion not in same]
    aliases = tuple(alias for suggestion in same for alias in suggestion.aliases)
    replaced = name.source or OWN_SOURCE
    sources = [source for suggestion in same for source in suggestion.said_by if source.source != replaced]
    if name.source:
        sources.insert(0, SuggestionSource(name.source, "", name.probability))
        sources.sort(key=lambda source: -source.probability)
    said = [source.probability for source in sources]
    probability = agreed(said if name.source else [name.probability, *said])
    suggestion = NameSuggestion(name.name, probability, name.scene_id, aliases, tuple(sources))
    ranked = sorted([suggestion, *rest], key=lambda suggestion: -suggestion.probability)
    return replace(obj, suggestions=tuple(ranked))
