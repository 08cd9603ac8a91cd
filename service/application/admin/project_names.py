"""Known names of one project: listed, forgotten, suggested for things that look alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime

from fastsplat.service.application.base.paging import read_page_token, write_page_token
from fastsplat.service.application.base.validate import check_page_size
from fastsplat.service.common.dictionary import label_key
from fastsplat.service.query.language.query_text import TextQuery
from fastsplat.service.query.things.names_by_looks import KnownThing, NameFromScene, names_by_looks
from fastsplat.service.query.things.thing_names import ThingNames
from fastsplat.service.scene.types import Thing, Things
from fastsplat.service.settings import Settings
from fastsplat.service.store.store import Store
from fastsplat_contract.known_names import KnownName, KnownNameList
from fastsplat_contract.thing_messages import NameSuggestion, SceneThing


class KnownNames:
    """The names of one project; no other project has them. Every method is safe from any thread."""

    def __init__(self, store: Store, settings: Settings) -> None:
        self._store = store
        self._settings = settings

    def list(self, page_size: int = 0, page_token: str = "") -> KnownNameList:
        """The names that people gave and that stand, newest first, in pages as `SceneService.list_scenes`.

        Raises:
            InvalidInputError: a negative size, or a token that no page returned.
        """
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
                thing_id=record.thing_id,
                named_at=datetime.fromtimestamp(record.named_at, UTC),
                picture=record.picture,
            )
            for record in records[:size]
        ]
        return KnownNameList(tuple(names), token)

    def forget(self, name_id: str) -> None:
        """Suggest a name no more, and remove what it looks like from the list; its scene keeps the name.

        Raises:
            NotFoundError: the project has none of that id.
        """
        self._store.reserve.lend(lambda: self._store.known_names.forget(name_id))

    def forget_all(self) -> None:
        """As `forget`, of every name of the project."""
        self._store.reserve.lend(self._store.known_names.forget_all)

    def suggest(self, scene_id: str, table: Things, listed: Sequence[SceneThing]) -> tuple[SceneThing, ...]:
        """Listed things with the names of other scenes among their suggestions; where there is one scene alone, as they
        are: what others are called is nothing to show.

        Args:
            scene_id: whose things they are.
            table: all things of the scene's version.
            listed: some of them.
        """
        names = self._by_looks(scene_id, table.table)
        return tuple(_suggested(thing, names[thing.id]) if thing.id in names else thing for thing in listed)

    def asked(self, query: TextQuery, scene_id: str, names: ThingNames) -> TextQuery:
        """A question to a scene that knows what other scenes suggest for its things, as they are listed."""
        return replace(query, elsewhere=self._by_looks(scene_id, names.present))

    def _by_looks(self, scene_id: str, things: Sequence[Thing]) -> Mapping[int, NameFromScene]:
        if self._store.only_scene or not any(thing.appearance for thing in things):
            return {}
        known = [
            KnownThing(record.scene_id, record.name, record.appearance)
            for record in self._store.known_names.all()
            if record.scene_id != scene_id
        ]
        return names_by_looks(things, known)


def _suggested(thing: SceneThing, name: NameFromScene) -> SceneThing:
    if thing.name and label_key(thing.name) == label_key(name.name):
        return thing
    others = [own for own in thing.suggestions if label_key(own.name) != label_key(name.name)]
    suggestion = NameSuggestion(name.name, name.probability, name.scene_id)
    ranked = sorted([suggestion, *others], key=lambda other: -other.probability)
    return replace(thing, suggestions=tuple(ranked))
