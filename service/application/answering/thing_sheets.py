"""Sheets of things without a name, for whoever can tell what they are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fastsplat.service.application.admin.project_names import KnownNames
from fastsplat.service.application.answering.costs import rendering_cost
from fastsplat.service.application.answering.landmark_cache import read_photo
from fastsplat.service.application.answering.open_scenes import OpenScenes
from fastsplat.service.application.base.memory import MemoryBudget, picture_bytes
from fastsplat.service.application.base.paging import page_after
from fastsplat.service.application.base.validate import check_page_size, check_texts
from fastsplat.service.capture.photos.scene_photos import photo_path
from fastsplat.service.common.call_scheduling import charge
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.drawing.thing_sheets import MOST_THINGS, cell_side, thing_cell, thing_sheet
from fastsplat.service.query.measures.thing_views import CANDIDATES, best_view_of_each, small_view
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.changes import changed_views
from fastsplat.service.settings import Settings
from fastsplat.service.store.store import Store
from fastsplat_contract.thing_messages import SceneThing
from fastsplat_contract.thing_sheets import NeighborThing, SheetThing, ThingSheet

_SIDE = 1_024
"""Pixels of the longer side that a photo or a rendering has at most before things are cut from it."""
_NEIGHBORS = 3


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
            scene_id: which scene.
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
            picture, shown = self._drawn(index, named, folder) if named else (b"", ())
            seen = {each.thing for each in shown}
            unseen = tuple(thing.id for thing in named if thing.id not in seen)
            return ThingSheet(picture, shown, unseen, index.scene.scale == "METRIC", token, read_version)

        return self._scenes.reading(scene_id, version, read)

    def _drawn(
        self, index: SceneIndex, things: Sequence[SceneThing], folder: Path
    ) -> tuple[bytes, tuple[SheetThing, ...]]:
        """The picture of some things, empty if no camera shows any, and what it shows."""
        cameras, gaussians = index.scene.cameras, len(index.scene.gaussians)
        if not cameras:
            return b"", ()
        small, large = small_view(cameras[0]), small_view(cameras[0], _SIDE)
        looked = [small] * min(len(cameras), CANDIDATES * len(things)) + [large] * min(len(cameras), len(things))
        charge(rendering_cost(looked, 1, gaussians))
        held = picture_bytes("thing_map", small, gaussians) + picture_bytes("rgb", large, gaussians)
        with self._memory.reserve(held, "things"):
            best = best_view_of_each(index, [thing.id for thing in things])
            shown = [thing for thing in things if thing.id in best]
            if not shown:
                return b"", ()
            photos = self._photos(index, folder, {best[thing.id].name for thing in shown})
            side, cells = cell_side(len(shown)), {}
            for name in sorted({best[thing.id].name for thing in shown}):  # one whole picture at a time
                check_cancelled()
                whole = (
                    read_photo(photos[name], _SIDE)
                    if name in photos
                    else index.render(small_view(index.view(name), _SIDE))
                )
                for thing in shown:
                    if best[thing.id].name == name:
                        cells[thing.id] = thing_cell(whole, best[thing.id].mask, side)
            picture = thing_sheet([cells[thing.id] for thing in shown])
        told = (
            SheetThing(
                number,
                thing.id,
                best[thing.id].name,
                best[thing.id].name in photos,
                None if thing.box is None else thing.box.size,
                thing.surface,
                _neighbors(thing, index.things.listed),
                thing.suggestions,
            )
            for number, thing in enumerate(shown, start=1)
        )
        return picture, tuple(told)

    def _photos(self, index: SceneIndex, folder: Path, views: set[str]) -> dict[str, Path]:
        """The photos of some views that show what the version shows, by the views' names."""
        if changed_views(index.scene.quality):
            return {}
        numbered = ((posed.name, photo_path(folder, n)) for n, posed in enumerate(index.scene.cameras))
        photos = {name: path for name, path in numbered if name in views and path.is_file()}
        if photos:
            self._store.blobs.check_version(folder, *(each.relative_to(folder).as_posix() for each in photos.values()))
        return photos


def _neighbors(thing: SceneThing, listed: Sequence[SceneThing]) -> tuple[NeighborThing, ...]:
    """At most three things by the distance of their middles."""
    if thing.centroid is None:
        return ()
    others = [each for each in listed if each.id != thing.id and each.centroid is not None]
    middles = np.array([each.centroid for each in others]).reshape(-1, 3)
    nearest = np.linalg.norm(middles - np.array(thing.centroid), axis=1).argsort(kind="stable")[:_NEIGHBORS]
    return tuple(NeighborThing(others[n].id, others[n].name) for n in nearest.tolist())
