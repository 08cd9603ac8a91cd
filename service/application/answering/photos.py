"""Photos kept with finished scenes, and the best views of objects."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fastsplat.service.application.answering.costs import check_encodings
from fastsplat.service.application.answering.mask_encodings import encoded_mask
from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.base.memory import picture_bytes
from fastsplat.service.application.base.paging import page_of
from fastsplat.service.application.base.validate import check_page_size, check_texts
from fastsplat.service.capture.photos.scene_photos import observed_photo_path, photo_path
from fastsplat.service.query.language.words.query_text import TextQuery, check_query
from fastsplat.service.query.measures.object_views import OBJECT_VIEW_SIDE, best_object_views
from fastsplat.service.query.ranked_scene import RankedQuery, RankedScene
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.codec.json_codec import from_plain
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, NotFoundError, SceneFileError
from fastsplat_contract.messages.requests import MAX_VIEWS
from fastsplat_contract.photos.next_photos import NextPhotoList
from fastsplat_contract.photos.photo_verdicts import PhotoVerdict, PhotoVerdictList
from fastsplat_contract.photos.scene_photos import BestView, BestViewList, PhotoList, ScenePhoto

_OBSERVED = re.compile(r"(e[0-9a-f]{16})/([0-9]{1,4})")
"""Photo names of observations, see `ObservedPhoto.view`."""
_USUAL_VIEWS = 3
_MAX_NAMED = 20


class Photos:
    """Photos of scenes. Thread-safe."""

    def __init__(self, context: ProjectContext) -> None:
        self._context = context

    def all(self, scene_id: str, version: str = "", page_size: int = 0, page_token: str = "") -> PhotoList:
        """Photos kept with a scene, in camera order, paged as `SceneService.list_scenes`."""
        size = check_page_size(page_size, self._context.settings.store)
        version, names, folder = self._cameras(scene_id, version)
        page, token = page_of(tuple(enumerate(names)), size, page_token, f"photos {scene_id} {version}")
        sizes = ((name, size_of(photo_path(folder, number))) for number, name in page)
        return PhotoList(tuple(ScenePhoto(name, size) for name, size in sizes if size), token, version)

    def path(self, scene_id: str, view: str, version: str = "") -> tuple[Path, str]:
        """JPEG file of a camera's or an observation's photo, immutable until deletion, and its version.

        Raises:
            NotFoundError: no such scene, version or view, or it has no photo.
            NotReadyError: as `Answers.query`.
            SceneFileError: the file's digest is wrong.
        """
        check_texts(view, "view")
        version, names, folder = self._cameras(scene_id, version)
        observed = _OBSERVED.fullmatch(view)
        if view not in names and observed is None:
            known = ", ".join(names[:_MAX_NAMED])
            raise NotFoundError(
                f"no view {view[:80]!r} in this scene", field="view", hint=f"Its views are: {known[:2_000]}."
            )
        if view in names or observed is None:
            path = photo_path(folder, names.index(view))
        else:
            path = observed_photo_path(folder, observed[1], int(observed[2]))
        if path.is_file():
            try:
                self._context.store.blobs.check_version(folder, path.relative_to(folder).as_posix())
            except SceneFileError:
                if folder.is_dir():
                    raise
            else:
                return path, version
        if not folder.is_dir():
            raise NotFoundError(f"scene {scene_id!r} was deleted meanwhile", field="scene")
        raise NotFoundError(
            f"no photo of view {view[:80]!r} is stored with this scene",
            field="view",
            hint="They are stored with scenes that are made of photos while FASTSPLAT_PHOTOS__KEEP is on. The picture "
            '"rgb" of the view shows the scene itself.',
        )

    def next_photos(self, scene_id: str, version: str = "") -> NextPhotoList:
        """At most three useful viewpoints for further photos, best first; raises as `Answers.query`.

        None where no viewpoint would add much, and for scenes without cameras.
        """
        from fastsplat.service.query.measures.next_viewpoints import next_photos  # scipy loads with the first call

        check_texts(version, "version")
        index, name = self._context.scenes.open(scene_id, version)
        return NextPhotoList(next_photos(index), name)

    def best_views(
        self, scene_id: str, object_ids: Sequence[int] = (), text: str = "", max_views: int = 0, version: str = ""
    ) -> BestViewList:
        """Cameras that show some objects best, by their visible share of the picture.

        Objects cut off by the picture's edge count less. Empty if no camera shows them, or nothing answers.

        Args:
            object_ids: ids of objects or parts, seen together.
            text: instead of `object_ids`: those that answer it.
            max_views: 0: three.

        Raises:
            NotFoundError: no such scene, version or object.
            NotReadyError: as `Answers.query`.
            InvalidInputError: not exactly one of objects and text; a negative number of views.
            LimitExceededError: more than 16 views, or too long a text.
        """
        check_texts(version, "version")
        if bool(object_ids) == bool(text):
            raise InvalidInputError(
                "best views need exactly one of objects and text",
                field="object_ids",
                hint="Send ids of objects, or a text.",
            )
        if max_views < 0:
            raise InvalidInputError(f"{max_views} views", field="max_views", hint="0 is the server's default.")
        if max_views > MAX_VIEWS:
            raise LimitExceededError(
                f"{max_views} views", field="max_views", limit=f"{MAX_VIEWS} views", hint="Ask for fewer."
            )
        query = check_query((text,), self._context.settings.query) if text else None
        if query is not None:
            check_encodings(query)
        version, names, folder = self._cameras(scene_id, version)
        has_photo = {name for number, name in enumerate(names) if photo_path(folder, number).is_file()}
        index, read_version = self._context.scenes.open(scene_id, version)
        object_ids = (
            index.objects.with_members(object_ids)
            if query is None
            else _answering(index, self._context.known_names.suggesting(scene_id, index.ranked), query)
        )
        if not object_ids or not index.scene.cameras:
            return BestViewList((), read_version)
        size = picture_bytes(
            "object_map", index.scene.cameras[0].limited_to(OBJECT_VIEW_SIDE), len(index.scene.gaussians)
        )
        with self._context.memory.reserve(size, "objects"):
            best = best_object_views(index, object_ids, max_views or _USUAL_VIEWS)
        views = (
            BestView(
                view.name,
                view.share,
                view.cut_off,
                view.name in has_photo,
                encoded_mask(view.mask, view.name, 0, "rle"),
            )
            for view in best
        )
        return BestViewList(tuple(views), read_version)

    def _cameras(self, scene_id: str, version: str) -> tuple[str, tuple[str, ...], Path]:
        """Resolved version, camera names in order, and the version's folder."""
        version = self._context.scenes.version(scene_id, version)
        names = tuple(row["name"] for row in self._context.store.scenes.scene(scene_id).cameras)
        return version, names, self._context.scenes.folder(scene_id, version)


def _answering(index: SceneIndex, ranked: RankedScene, query: TextQuery) -> tuple[int, ...]:
    """Ids of the objects that answer a text."""
    (answer,) = RankedQuery(ranked, query).answer(lambda: index.objects)
    if answer.is_absent:
        return ()
    return answer.object_ids or tuple(obj.id for obj in index.objects_of(answer))


def size_of(path: Path) -> int:
    """Bytes of a file, 0 if missing."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def photo_page(
    rows: Sequence[Mapping[str, Any]], quality: Mapping[str, Any], size: int, page_token: str, scene_id: str
) -> PhotoVerdictList:
    """A page of stored photo verdicts, with the training's photometric corrections."""
    placed = sum(bool(row["placed"]) for row in rows)
    page, token = page_of(rows, size, page_token, f"photos {scene_id} {len(rows)}")
    corrections = quality.get("photometric", {})
    photos = tuple(_verdict(row, corrections.get(row["name"])) for row in page)
    return PhotoVerdictList(photos, token, bool(rows), placed, len(rows))


def _verdict(row: Mapping[str, Any], correction: Sequence[float] | None) -> PhotoVerdict:
    verdict = from_plain(PhotoVerdict, dict(row))
    if correction is None:
        return verdict
    exposure_ev, red_ev, blue_ev = correction
    return replace(verdict, exposure_ev=exposure_ev, red_ev=red_ev, blue_ev=blue_ev)
