"""Contact sheets of unnamed objects, for naming."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.base.memory import picture_bytes
from fastsplat.service.application.base.paging import page_of
from fastsplat.service.application.base.validate import check_page_size, check_texts
from fastsplat.service.jobs.nameless_objects import SHEET_PHOTO_SIDE, drawn_sheet, kept_photos, written_on
from fastsplat.service.query.drawing.contact_sheets import MOST_OBJECTS
from fastsplat.service.query.measures.object_views import OBJECT_VIEW_SIDE
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.messages.contact_sheets import ContactSheet, SheetObject
from fastsplat_contract.messages.objects import SceneObject


class ContactSheets:
    """Sheets of finished scenes. Thread-safe."""

    def __init__(self, context: ProjectContext) -> None:
        self._context = context

    def page(self, scene_id: str, version: str = "", page_size: int = 0, page_token: str = "") -> ContactSheet:
        """At most 20 unnamed objects in one picture, by id, paged even while names change.

        Each is cropped from the photo that shows it best, or from a rendering where none is kept, or edits changed what
        photos show (removed objects stay removed).

        Args:
            page_size: 0 or more than 20: 20.
            page_token: "" or the previous page's.

        Raises:
            NotFoundError: no such scene or version.
            NotReadyError: as `Answers.query`.
            InvalidInputError: a negative size, or an unknown token.
            SceneFileError: a photo is damaged.
        """
        check_texts(version, "version")
        size = min(
            check_page_size(page_size, self._context.settings.store) if page_size else MOST_OBJECTS, MOST_OBJECTS
        )
        index, read_version = self._context.scenes.open(scene_id, version)
        nameless = [obj for obj in index.objects.listed if not obj.name]
        page, token = page_of(nameless, size, page_token, f"sheet {scene_id}", lambda obj: obj.id)
        named = self._context.known_names.suggest(scene_id, index.ranked, page)
        folder = self._context.scenes.folder(scene_id, read_version)
        picture, objects = self._picture(index, named, folder) if named else (b"", ())
        seen = {obj.object_id for obj in objects}
        unseen = tuple(obj.id for obj in named if obj.id not in seen)
        meters, written = index.scene.scale == "METRIC", written_on(index.objects.listed)
        return ContactSheet(picture, objects, unseen, meters, token, read_version, written)

    def _picture(
        self, index: SceneIndex, objects: Sequence[SceneObject], folder: Path
    ) -> tuple[bytes, tuple[SheetObject, ...]]:
        """Picture of some objects, empty if no camera shows any, and its content."""
        cameras, gaussians = index.scene.cameras, len(index.scene.gaussians)
        if not cameras:
            return b"", ()
        small, large = cameras[0].limited_to(OBJECT_VIEW_SIDE), cameras[0].limited_to(SHEET_PHOTO_SIDE)
        held = picture_bytes("object_map", small, gaussians) + picture_bytes("rgb", large, gaussians)
        with self._context.memory.reserve(held, "objects"):
            return drawn_sheet(index, objects, lambda views: self._photos(index, folder, views))

    def _photos(self, index: SceneIndex, folder: Path, views: set[str]) -> Mapping[str, Path]:
        photos = kept_photos(index, folder, views)
        if photos:
            self._context.store.blobs.check_version(
                folder, *(path.relative_to(folder).as_posix() for path in photos.values())
            )
        return photos
