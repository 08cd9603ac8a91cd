"""Unnamed things, drawn on sheets for the configured namer."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fastsplat.service.capture.photos.scene_photos import photo_path
from fastsplat.service.capture.views.kept_photos import read_photo
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.drawing.thing_sheets import MOST_THINGS, cell_side, thing_cell, thing_sheet
from fastsplat.service.query.measures.thing_views import best_view_of_each, small_view
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.settings import NamerSettings
from fastsplat_contract.messages.thing_sheets import NeighborThing, SheetThing, ThingSheet
from fastsplat_contract.messages.things import SceneThing

if TYPE_CHECKING:
    from fastsplat_client.namer import NamedSheets

SHEET_PHOTO_SIDE = 1_024
"""Maximum longer side in pixels of a photo or rendering from which things are cropped."""
_NEIGHBORS = 3
_MOST_LINES = 200


def said_by(namer: NamerSettings, sheets: Iterable[ThingSheet]) -> NamedSheets:
    """Asks the configured namer about a scene's sheets; raises as `ask_namer`."""
    # Imported lazily: servers without a namer do not need the client.
    from fastsplat_client.namer import Namer, ask_namer

    return ask_namer(Namer(namer.url, namer.model, namer.key, namer.request_s, namer.total_s), sheets)


def sheets_of(index: SceneIndex, folder: Path, version: str) -> Iterator[ThingSheet]:
    """Yields all sheets of a version, using only its folder."""
    nameless = [thing for thing in index.things.listed if not thing.name]
    for first in range(0, len(nameless) if index.scene.cameras else 0, MOST_THINGS):
        things = nameless[first : first + MOST_THINGS]
        picture, shown = drawn_sheet(index, things, lambda views: kept_photos(index, folder, views))
        seen = {each.thing_id for each in shown}
        unseen = tuple(thing.id for thing in things if thing.id not in seen)
        meters, written = index.scene.scale == "METRIC", written_on(index.things.listed)
        yield ThingSheet(picture, shown, unseen, meters, "", version, written)


def drawn_sheet(
    index: SceneIndex, things: Sequence[SceneThing], photos_of: Callable[[set[str]], Mapping[str, Path]]
) -> tuple[bytes, tuple[SheetThing, ...]]:
    """Draws at most `MOST_THINGS` things; empty bytes if no camera shows any.

    Cameras without a photo in `photos_of` (see `kept_photos`) are rendered. Raises `SceneFileError` for a damaged
    photo.
    """
    best = best_view_of_each(index, [thing.id for thing in things])
    shown = [thing for thing in things if thing.id in best]
    if not shown:
        return b"", ()
    photos = photos_of({best[thing.id].name for thing in shown})
    side, cells = cell_side(len(shown)), {}
    for name in sorted({best[thing.id].name for thing in shown}):  # one full picture in memory at a time
        check_cancelled()
        if name in photos:
            whole = read_photo(photos[name], SHEET_PHOTO_SIDE)
        else:
            whole = index.render(small_view(index.view(name), SHEET_PHOTO_SIDE))
        for thing in shown:
            if best[thing.id].name == name:
                cells[thing.id] = thing_cell(whole, best[thing.id].mask, side)
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
    return thing_sheet([cells[thing.id] for thing in shown]), tuple(told)


def written_on(things: Sequence[SceneThing]) -> tuple[str, ...]:
    """Distinct text lines read on things, most probable first, at most `_MOST_LINES`."""
    lines = [read for thing in things for read in thing.reads if read.kind == "text"]
    ranked = sorted(lines, key=lambda one: -one.probability)
    return tuple(dict.fromkeys(read.text for read in ranked))[:_MOST_LINES]


def kept_photos(index: SceneIndex, folder: Path, views: set[str]) -> Mapping[str, Path]:
    """Kept photos by view name, from the version's folder; none once edits changed views."""
    if index.scene.facts.changed_by:
        return {}
    numbered = ((posed.name, photo_path(folder, n)) for n, posed in enumerate(index.scene.cameras))
    return {name: path for name, path in numbered if name in views and path.is_file()}


def _neighbors(thing: SceneThing, listed: Sequence[SceneThing]) -> tuple[NeighborThing, ...]:
    """At most three nearest things by centroid distance."""
    if thing.centroid is None:
        return ()
    others = [each for each in listed if each.id != thing.id and each.centroid is not None]
    middles = np.array([each.centroid for each in others]).reshape(-1, 3)
    nearest = np.linalg.norm(middles - np.array(thing.centroid), axis=1).argsort(kind="stable")[:_NEIGHBORS]
    return tuple(NeighborThing(others[n].id, others[n].name) for n in nearest.tolist())
