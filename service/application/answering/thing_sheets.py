"""Sheets of things without a name, for whoever can tell what they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fastsplat.service.application.admin.project_names import KnownNames
from fastsplat.service.application.answering.open_scenes import OpenScenes
from fastsplat.service.application.base.memory import MemoryBudget, picture_bytes
from fastsplat.service.application.base.paging import page_after
from fastsplat.service.application.base.validate import check_page_size, check_texts
from fastsplat.service.jobs.nameless_things import SHEET_PHOTO_SIDE, drawn_sheet, kept_photos, written_on
from fastsplat.service.query.drawing.thing_sheets import MOST_THINGS
from fastsplat.service.query.measures.thing_views import small_view
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.settings import Settings
from fastsplat.service.store.store import Store
from fastsplat_contract.messages.thing_sheets import SheetThing, ThingSheet
from fastsplat_contract.messages.things import SceneThing


class ThingSheets:
    """Sheets of finished scenes. Every method is safe from any thread."""

    def __init__(
        self, store: Store, settings: Settings, scenes: OpenScenes, memory: MemoryBudget, known_names: KnownNames
    ) -> None:
        self._store = store
        self._settings = settings
        self._scenes = scenes
        self._memory = memory
        self._known_names = known_names

    def page(self, scene_id: str, version: str = "", page_size: int = 0, page_token: str = "") -> ThingSheet:
        """At most 20 things without a name in one picture, by id; the pages together show all of them, also where names
        are given or suggested between two pages.

        Each is cut from the photo that shows it best. Where none is kept, or edits made the version show what its
        photos do not (what was removed stays so), the scene is rendered instead.

        Args:
            version: of the scene; "" is the current one.
            page_size: at most so many things; 0 and more than 20: 20.
            page_token: "" or what the page before returned.

        Raises:
            NotFoundError: there is no such scene or version.
            NotReadyError: as `Answers.query`.
            InvalidInputError: a negative size, or a token that no page of this scene returned.
            SceneFileError: a photo is damaged.
        """
        check_texts(version, "version")
        size = min(check_page_size(page_size, self._settings.store) if page_size else MOST_THINGS, MOST_THINGS)

        def read(index: SceneIndex, read_version: str) -> ThingSheet:
            nameless = [thing for thing in index.things.listed if not thing.name]
            page, token = page_after(nameless, lambda thing: thing.id, size, page_token, f"sheet {scene_id}")
            named = self._known_names.suggest(scene_id, index.ranked, page)
            folder = self._scenes.folder(scene_id, read_version)
            picture, shown = self._picture(index, named, folder) if named else (b"", ())
            seen = {each.thing for each in shown}
            unseen = tuple(thing.id for thing in named if thing.id not in seen)
            meters, written = index.scene.scale == "METRIC", written_on(index.things.listed)
            return ThingSheet(picture, shown, unseen, meters, token, read_version, written)

        return self._scenes.reading(scene_id, version, read)

    def _picture(
        self, index: SceneIndex, things: Sequence[SceneThing], folder: Path
    ) -> tuple[bytes, tuple[SheetThing, ...]]:
        """The picture of some things, empty if no camera shows any, and what it shows."""
        cameras, gaussians = index.scene.cameras, len(index.scene.gaussians)
        if not cameras:
            return b"", ()
        small, large = small_view(cameras[0]), small_view(cameras[0], SHEET_PHOTO_SIDE)
        held = picture_bytes("thing_map", small, gaussians) + picture_bytes("rgb", large, gaussians)
        with self._memory.reserve(held, "things"):
            return drawn_sheet(index, things, lambda views: self._photos(index, folder, views))

    def _photos(self, index: SceneIndex, folder: Path, views: set[str]) -> Mapping[str, Path]:
        photos = kept_photos(index, folder, views)
        if photos:
            self._store.blobs.check_version(folder, *(each.relative_to(folder).as_posix() for each in photos.values()))
        return photos
