"""Queries to finished scenes: answers, pictures, things, picking, measuring."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from fastsplat.service.application.admin.project_names import KnownNames
from fastsplat.service.application.answering.all_scenes import AllScenes, completed
from fastsplat.service.application.answering.costs import check_encodings, check_pixels
from fastsplat.service.application.answering.mask_encodings import encode_mask3d, encoded_mask, view_mask
from fastsplat.service.application.answering.open_scenes import OpenScenes, asker_of
from fastsplat.service.application.answering.pictures import picture, question_of
from fastsplat.service.application.base.memory import MemoryBudget, mask3d_bytes, masks_bytes, picture_bytes
from fastsplat.service.application.base.paging import page_of
from fastsplat.service.application.base.validate import check_page_size, check_pick, check_texts
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.language.words.query_text import TextQuery, check_query
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.things.picking import chosen_level, pick_box, pick_pixel, pick_point
from fastsplat.service.scene.artefact.scene import provisional_of
from fastsplat.service.settings import Settings
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, NotFoundError, SceneFileError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.masks import ViewMask, pack_mask3d
from fastsplat_contract.messages.measurements import Measurement, MeasureRequest
from fastsplat_contract.messages.queries import Answer, QueryOut, QueryRequest
from fastsplat_contract.messages.things import PickedThing, PickRequest, ThingList
from fastsplat_contract.photos.pictures import PictureRequest

_Camera = tuple[str, int, PosedCamera]
"""View name ("": not the scene's own), number in the request, and camera."""


class Answers:
    """Queries to finished scenes. Thread-safe."""

    def __init__(
        self, store: Store, settings: Settings, scenes: OpenScenes, memory: MemoryBudget, known_names: KnownNames
    ) -> None:
        self._store = store
        self._settings = settings
        self._scenes = scenes
        self._memory = memory
        self._known_names = known_names
        self._all_scenes = AllScenes(store, settings.calls, scenes, memory, known_names, self._of_scene)

    def query(self, request: QueryRequest) -> QueryOut:
        """Answers one scene, by text, or without a scene id every READY scene, newest first.

        Cameras, views and versions need a scene id. Scenes that were not asked are listed as skipped.

        Raises:
            NotFoundError: unknown scene, version or view.
            NotReadyError: the scene's training has not finished, or has failed.
            InvalidInputError: an empty text, or "mask2d" without a camera or view.
            LimitExceededError: too many or too long texts, too many or too large cameras.
            ModelUnavailableError: the scene's text encoder is missing.
            CancelledError: the caller stopped waiting.
        """
        query = self._check(request)
        if request.scene_id:
            return QueryOut(self._of_scene(query, request))
        return self._all_scenes.query(query, request)

    def picture(self, request: PictureRequest) -> bytes:
        """A view of a scene as a picture or array file; raises as `query`."""
        question = question_of(request)
        query = check_query((question,), self._settings.query) if question else None
        check_texts(dataclasses.replace(request, scene_id=""))

        def read(index: SceneIndex, _: str) -> bytes:
            posed = request.camera or index.view(request.view or "")
            index.check_view(posed)
            gaussians = len((index.coarse if request.coarse else index).scene.gaussians)
            with self._memory.reserve(picture_bytes(request.kind, posed, gaussians), "camera"):
                ranked = self._known_names.suggesting(request.scene_id, index.ranked)
                return picture(index, ranked, dataclasses.replace(request, camera=posed), query)

        return self._scenes.reading(request.scene_id, request.version, read)

    def scene_ply(self, scene_id: str, version: str = "") -> tuple[Path, str]:
        """Path of the scene's 3DGS PLY file, immutable until deletion, and its version.

        Raises:
            NotFoundError, NotReadyError: as `query`.
            SceneFileError: the file's digest is wrong.
        """
        version = self._scenes.version(scene_id, version)
        folder = self._scenes.folder(scene_id, version)
        path = folder / "scene.ply"
        try:
            self._store.blobs.check_version(folder, path.name)
        except SceneFileError:
            if folder.is_dir():
                raise
        if not path.is_file():
            raise NotFoundError(f"scene {scene_id!r} was deleted meanwhile", field="scene")
        return path, version

    def list_things(
        self, scene_id: str, version: str = "", page_size: int = 0, page_token: str = "", parts: bool = False
    ) -> ThingList:
        """Every thing of a scene by id, paged as `SceneService.list_scenes`; `parts` includes parts."""
        size = check_page_size(page_size, self._settings.store)

        def read(index: SceneIndex, read_version: str) -> ThingList:
            listed = index.things.listed_with_parts if parts else index.things.listed
            page, token = page_of(
                listed, size, page_token, f"things {scene_id} {read_version}{' parts' if parts else ''}"
            )
            return ThingList(self._known_names.suggest(scene_id, index.ranked, page), token, read_version)

        return self._scenes.reading(scene_id, version, read)

    def pick(self, request: PickRequest) -> PickedThing:
        """Picks the thing, part and group at a pixel, box or point.

        The mask is of the requested level.

        Raises:
            NotFoundError: unknown scene, version or view; no thing there, or no part or group as requested.
            NotReadyError: as `query`.
            InvalidInputError: not exactly one of pixel, box and point; a pixel or box outside the picture, or without
                exactly one of camera and view.
            LimitExceededError: too large a camera.
        """
        check_pick(request)
        check_texts(dataclasses.replace(request, scene_id=""))

        def read(index: SceneIndex, read_version: str) -> PickedThing:
            posed = index.view(request.view) if request.view is not None else request.camera
            if posed is not None:
                check_pixels((posed,), 1)
            things = index.things
            if request.point is not None:
                levels = pick_point(things, request.point)
            else:
                assert posed is not None
                if request.pixel is not None:
                    levels = pick_pixel(things, posed, request.pixel)
                else:
                    assert request.box is not None
                    levels = pick_box(things, posed, request.box)
            chosen, ids = chosen_level(levels, request.level), {each.level: each.id for each in levels}
            mask = None
            if posed is not None:
                inside = things.mask(posed, (chosen.id,))
                mask = encoded_mask(inside, request.view or "", 0, request.mask2d_encoding)
            mask3d = pack_mask3d(things.rows((chosen.id,)), "bits") if request.mask3d else None
            part = things.get(ids["part"]) if "part" in ids else None
            (thing,) = self._known_names.suggest(request.scene_id, index.ranked, (things.get(ids["thing"]),))
            provisional = provisional_of(index.scene.quality)
            return PickedThing(thing, mask, read_version, part, levels, chosen.level, mask3d, provisional)

        return self._scenes.reading(request.scene_id, request.version, read)

    def measure(self, request: MeasureRequest) -> Measurement:
        """Measures the distance of two places, or the size or position of one.

        Raises:
            NotFoundError: unknown scene, version, view or thing; nothing is seen at a pixel.
            NotReadyError: as `query`.
            InvalidInputError: not one or two places, or an invalid one.
        """
        check_texts(dataclasses.replace(request, scene_id=""))

        def read(index: SceneIndex, read_version: str) -> Measurement:
            from fastsplat.service.query.measures.measuring import measure  # torch loads with the first measurement

            return measure(index, request.places, read_version)

        return self._scenes.reading(request.scene_id, request.version, read)

    def _of_scene(self, query: TextQuery, request: QueryRequest) -> tuple[Answer, ...]:
        def read(index: SceneIndex, version: str) -> tuple[Answer, ...]:
            cameras: list[_Camera] = [("", number, posed) for number, posed in enumerate(request.cameras)]
            cameras += [(name, 0, index.view(name)) for name in request.views]
            if "mask2d" in request.outputs:
                views = [posed for _, _, posed in cameras]
                check_pixels(views, len(request.texts))
                for posed in views:
                    index.check_view(posed)
            asker = asker_of(index, request)
            ranked = self._known_names.suggesting(request.scene_id, index.ranked)
            size, field = _bytes_to_hold(index, cameras, request)
            with self._memory.reserve(size, field):
                return tuple(
                    completed(
                        answer,
                        request,
                        version,
                        self._settings.calls,
                        masks=_masks(index, answer, cameras, request),
                        mask3d=encode_mask3d(index.mask3d(answer), request.mask3d_encoding, index.scene.gaussians)
                        if "mask3d" in request.outputs
                        else None,
                        objects=self._known_names.suggest(request.scene_id, index.ranked, index.objects_of(answer))
                        if "objects" in request.outputs
                        else None,
                    )
                    for answer in ranked.answer(query, lambda: index.things, asker)
                )

        return self._scenes.reading(request.scene_id, request.version, read)

    def _check(self, request: QueryRequest) -> TextQuery:
        query = check_query(
            request.texts,
            self._settings.query,
            negatives=request.negatives or None,
            templates=request.templates or None,
            coverage=request.coverage,
        )
        check_encodings(query)
        if "mask2d" in request.outputs:
            check_pixels(request.cameras, len(request.texts))
        check_texts(dataclasses.replace(request, scene_id=""))  # an unknown id is a NotFoundError
        if "mask2d" in request.outputs and request.scene_id and not (request.cameras or request.views):
            raise InvalidInputError(
                '"mask2d" needs a camera or a view', field="cameras", hint="Send a pose, or the name of a view."
            )
        if request.mask3d_encoding == "ply" and "mask3d" in request.outputs and len(request.texts) > 1:
            raise LimitExceededError(
                f"{len(request.texts)} texts with their Gaussians as PLY",
                field="mask3d_encoding",
                limit="1 text",
                hint="Ask in several requests, or for another encoding.",
            )
        if request.max_matches < -1:
            raise InvalidInputError(
                f"{request.max_matches} matches", field="max_matches", hint="-1 means all, 0 the server's default."
            )
        limits = self._settings.query
        count = len(request.cameras) + len(request.views)
        if count > limits.max_poses:
            raise LimitExceededError(
                f"{count} cameras",
                field="cameras",
                limit=f"{limits.max_poses} cameras",
                hint="Ask in several requests.",
            )
        return query


def _masks(index: SceneIndex, answer: Answer, cameras: list[_Camera], request: QueryRequest) -> tuple[ViewMask, ...]:
    if "mask2d" not in request.outputs:
        return ()
    masks = []
    for camera in cameras:
        check_cancelled()
        masks.append(view_mask(index, answer, *camera, request.mask2d_encoding))
    return tuple(masks)


def _bytes_to_hold(index: SceneIndex, cameras: list[_Camera], request: QueryRequest) -> tuple[int, str]:
    """Estimated peak of an answer in bytes, and the field that dominates it."""
    texts, gaussians = len(request.texts), index.scene.gaussians
    mask2d = mask3d = 0
    if "mask2d" in request.outputs:
        mask2d = masks_bytes((posed for _, _, posed in cameras), texts, len(gaussians))
    if "mask3d" in request.outputs:
        mask3d = mask3d_bytes(request.mask3d_encoding, texts, gaussians)
    return mask2d + mask3d, "cameras" if mask2d >= mask3d else "texts"
