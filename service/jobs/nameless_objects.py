"""Unnamed objects, drawn on sheets for the configured captioner."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fastsplat.service.capture.photos.scene_photos import photo_path, read_photo
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.drawing.contact_sheets import MOST_OBJECTS, cell_side, contact_sheet, object_cell
from fastsplat.service.query.measures.object_views import best_view_of_each
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.settings import CaptionerSettings
from fastsplat_contract.messages.contact_sheets import ContactSheet, NeighborObject, SheetObject
from fastsplat_contract.messages.objects import SceneObject

if TYPE_CHECKING:
    from fastsplat_client.captioner import NamedSheets

SHEET_PHOTO_SIDE = 1_024
"""Maximum longer side in pixels of a photo or rendering from which objects are cropped."""
_NEIGHBORS = 3
_MOST_LINES = 200


def said_by(captioner: CaptionerSettings, sheets: Iterable[ContactSheet]) -> NamedSheets:
    """Asks the configured captioner about a scene's sheets; raises as `ask_captioner`."""
    # Imported lazily: servers without a captioner do not need the client.
    from fastsplat_client.captioner import Captioner, ask_captioner

    return ask_captioner(
        Captioner(captioner.url, captioner.model, captioner.key, captioner.request_s, captioner.total_s), sheets
    )


def sheets_of(index: SceneIndex, folder: Path, version: str) -> Iterator[ContactSheet]:
    """Yields all sheets of a version, using only its folder."""
    nameless = [obj for obj in index.objects.listed if not obj.name]
    for first in range(0, len(nameless) if index.scene.cameras else 0, MOST_OBJECTS):
        objects = nameless[first : first + MOST_OBJECTS]
        picture, sheet_objects = drawn_sheet(index, objects, lambda views: kept_photos(index, folder, views))
        seen = {obj.object_id for obj in sheet_objects}
        unseen = tuple(obj.id for obj in objects if obj.id not in seen)
        meters, written = index.scene.scale == "METRIC", written_on(index.objects.listed)
        yield ContactSheet(picture, sheet_objects, unseen, meters, "", version, written)


def drawn_sheet(
    index: SceneIndex, objects: Sequence[SceneObject], photos_of: Callable[[set[str]], Mapping[str, Path]]
) -> tuple[bytes, tuple[SheetObject, ...]]:
    """Draws at most `MOST_OBJECTS` objects; empty bytes if no camera shows any.

    Cameras without a photo in `photos_of` (see `kept_photos`) are rendered. Raises `SceneFileError` for a damaged
    photo.
    """
    best = best_view_of_each(index, [obj.id for obj in objects])
    visible = [obj for obj in objects if obj.id in best]
    if not visible:
        return b"", ()
    photos = photos_of({best[obj.id].name for obj in visible})
    side, cells = cell_side(len(visible)), {}
    for name in sorted({best[obj.id].name for obj in visible}):  # one full picture in memory at a time
        check_cancelled()
        if name in photos:
            whole = read_photo(photos[name], SHEET_PHOTO_SIDE)
        else:
            whole = index.render(index.view(name).limited_to(SHEET_PHOTO_SIDE))
        for obj in visible:
            if best[obj.id].name == name:
                cells[obj.id] = object_cell(whole, best[obj.id].mask, side)
    sheet_objects = (
        SheetObject(
            number,
            obj.id,
            best[obj.id].name,
            best[obj.id].name in photos,
            None if obj.box is None else obj.box.size,
            obj.surface,
            _neighbors(obj, index.objects.listed),
            obj.suggestions,
        )
        for number, obj in enumerate(visible, start=1)
    )
    return contact_sheet([cells[obj.id] for obj in visible]), tuple(sheet_objects)


def written_on(objects: Sequence[SceneObject]) -> tuple[str, ...]:
    """Distinct text lines read on objects, most probable first, at most `_MOST_LINES`."""
    lines = [read for obj in objects for read in obj.reads if read.kind == "text"]
    ranked = sorted(lines, key=lambda read: -read.probability)
    return tuple(dict.fromkeys(read.text for read in ranked))[:_MOST_LINES]


def kept_photos(index: SceneIndex, folder: Path, views: set[str]) -> Mapping[str, Path]:
    """Kept photos by view name, from the version's folder; none once edits changed views."""
    if index.scene.facts.changed_by:
        return {}
    numbered = ((posed.name, photo_path(folder, n)) for n, posed in enumerate(index.scene.cameras))
    return {name: path for name, path in numbered if name in views and path.is_file()}


def _neighbors(obj: SceneObject, listed: Sequence[SceneObject]) -> tuple[NeighborObject, ...]:
    """At most three nearest objects by centroid distance."""
    if obj.centroid is None:
        return ()
    candidates = [candidate for candidate in listed if candidate.id != obj.id and candidate.centroid is not None]
    middles = np.array([candidate.centroid for candidate in candidates]).reshape(-1, 3)
    nearest = np.linalg.norm(middles - np.array(obj.centroid), axis=1).argsort(kind="stable")[:_NEIGHBORS]
    return tuple(NeighborObject(candidates[n].id, candidates[n].name) for n in nearest.tolist())
