"""Queries to finished scenes: answers, pictures, objects, picking, measuring."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from fastsplat.service.application.answering.all_scenes import AllScenes, completed
from fastsplat.service.application.answering.costs import check_encodings, check_pixels
from fastsplat.service.application.answering.mask_encodings import encode_mask3d, encoded_mask
from fastsplat.service.application.answering.open_scenes import asker_of
from fastsplat.service.application.answering.pictures import picture, question_of
from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.base.memory import mask3d_bytes, masks_bytes, picture_bytes
from fastsplat.service.application.base.paging import page_of
from fastsplat.service.application.base.validate import check_page_size, check_pick, check_texts
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.language.words.query_text import TextQuery, check_query
from fastsplat.service.query.objects.picking import chosen_level, pick_box, pick_pixel, pick_point
from fastsplat.service.query.ranked_scene import RankedQuery, SubscribedQuery
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, NotFoundError, SceneFileError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.masks import ViewMask, pack_mask3d
from fastsplat_contract.messages.detections import DetectionList
from fastsplat_contract.messages.measurements import Measurement, MeasureRequest
from fastsplat_contract.messages.objects import ObjectList, PickedObject, PickRequest
from fastsplat_contract.messages.queries import Answer, QueryOut, QueryRequest
from fastsplat_contract.photos.pictures import PictureRequest

_Camera = tuple[str, int, PosedCamera]
"""View name ("": not the scene's own), number in the request, and camera."""


class Answers:
    """Queries to finished scenes. Thread-safe."""

    def __init__(self, context: ProjectContext) -> None:
        self._context = context
        self._all_scenes = AllScenes(context, self._of_scene)

    def query(self, request: QueryRequest, subscription: SubscribedQuery | None = None) -> QueryOut:
        """Answers one scene, by text, or without a scene id every READY scene, newest first.

        Cameras, views and versions need a scene id. Scenes that were not asked are listed as skipped. Further calls
        with the same `subscription` and another pose rank only what has changed.

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
            return QueryOut(self._of_scene(query, request, subscription))
        return self._all_scenes.query(query, request)

    def picture(self, request: PictureRequest) -> bytes:
        """A view of a scene as a picture or array file; raises as `query`."""
        question = question_of(request)
        query = check_query((question,), self._context.settings.query) if question else None
        check_texts(dataclasses.replace(request, scene_id=""))
        index, _ = self._context.scenes.open(request.scene_id, request.version)
        posed = index.viewpoint(request.camera, request.view)
        index.check_view(posed)
        gaussians = len((index.coarse if request.coarse else index).scene.gaussians)
        with self._context.memory.reserve(picture_bytes(request.kind, posed, gaussians), "camera"):
            ranked = self._context.known_names.suggesting(request.scene_id, index.ranked)
            return picture(index, ranked, dataclasses.replace(request, camera=posed), query)

    def scene_ply(self, scene_id: str, version: str = "") -> tuple[Path, str]:
        """Path of the scene's 3DGS PLY file, immutable until deletion, and its version.

        Raises:
            NotFoundError, NotReadyError: as `query`.
            SceneFileError: the file's digest is wrong.
        """
        version = self._context.scenes.version(scene_id, version)
        folder = self._context.scenes.folder(scene_id, version)
        path = folder / "scene.ply"
        try:
            self._context.store.blobs.check_version(folder, path.name)
        except SceneFileError:
            if folder.is_dir():
                raise
        if not path.is_file():
            raise NotFoundError(f"scene {scene_id!r} was deleted meanwhile", field="scene")
        return path, version

    def list_objects(
        self, scene_id: str, version: str = "", page_size: int = 0, page_token: str = "", parts: bool = False
    ) -> ObjectList:
        """Every object of a scene by id, paged as `SceneService.list_scenes`; `parts` includes parts."""
        size = check_page_size(page_size, self._context.settings.store)
        index, read_version = self._context.scenes.open(scene_id, version)
        listed = index.objects.listed_with_parts if parts else index.objects.listed
        page, token = page_of(listed, size, page_token, f"objects {scene_id} {read_version}{' parts' if parts else ''}")
        return ObjectList(self._context.known_names.suggest(scene_id, index.ranked, page), token, read_version)

    def detections(self, scene_id: str, version: str = "", page_size: int = 0, page_token: str = "") -> DetectionList:
        """Every whole object as a detection, by id, paged as `SceneService.list_scenes`."""
        from fastsplat.service.query.measures.object_detections import detections_of  # scipy loads with the first call

        check_texts(version, "version")
        size = check_page_size(page_size, self._context.settings.store)
        index, read_version = self._context.scenes.open(scene_id, version)
        page, token = page_of(index.objects.listed, size, page_token, f"detections {scene_id} {read_version}")
        named = self._context.known_names.suggest(scene_id, index.ranked, page)
        return detections_of(index, named, read_version, token)

    def pick(self, request: PickRequest) -> PickedObject:
        """Picks the object, part and group at a pixel, box or point.

        The mask is of the requested level.

        Raises:
            NotFoundError: unknown scene, version or view; no object there, or no part or group as requested.
            NotReadyError: as `query`.
            InvalidInputError: not exactly one of pixel, box and point; a pixel or box outside the picture, or without
                exactly one of camera and view.
            LimitExceededError: too large a camera.
        """
        check_pick(request)
        check_texts(dataclasses.replace(request, scene_id=""))
        index, read_version = self._context.scenes.open(request.scene_id, request.version)
        given = request.camera is not None or request.view is not None
        posed = index.viewpoint(request.camera, request.view) if given else None
        if posed is not None:
            check_pixels((posed,), 1)
        objects = index.objects
        if request.point is not None:
            levels = pick_point(objects, request.point)
        else:
            assert posed is not None
            if request.pixel is not None:
                levels = pick_pixel(objects, posed, request.pixel)
            else:
                assert request.box is not None
                levels = pick_box(objects, posed, request.box)
        chosen, ids = chosen_level(levels, request.level), {level.level: level.id for level in levels}
        mask = None
        if posed is not None:
            inside = objects.mask(posed, (chosen.id,))
            mask = encoded_mask(inside, request.view or "", 0, request.mask2d_encoding)
        mask3d = pack_mask3d(objects.rows((chosen.id,)), "bits") if request.mask3d else None
        part = objects.get(ids["part"]) if "part" in ids else None
        (obj,) = self._context.known_names.suggest(request.scene_id, index.ranked, (objects.get(ids["object"]),))
        provisional = index.scene.facts.draft
        return PickedObject(obj, mask, read_version, part, levels, chosen.level, mask3d, provisional)

    def measure(self, request: MeasureRequest) -> Measurement:
        """Measures the distance of two places, or the size or position of one.

        Raises:
            NotFoundError: unknown scene, version, view or object; nothing is seen at a pixel.
            NotReadyError: as `query`.
            InvalidInputError: not one or two places, or an invalid one.
        """
        from fastsplat.service.query.measures.measuring import measure  # torch loads with the first measurement

        check_texts(dataclasses.replace(request, scene_id=""))
        index, version = self._context.scenes.open(request.scene_id, request.version)
        return measure(index, request.places, version)

    def _of_scene(
        self, query: TextQuery, request: QueryRequest, subscription: SubscribedQuery | None = None
    ) -> tuple[Answer, ...]:
        index, version = self._context.scenes.open(request.scene_id, request.version)
        cameras: list[_Camera] = [("", number, posed) for number, posed in enumerate(request.cameras)]
        for _, number, posed in cameras:
            index.check_frame(posed, f"cameras[{number}]")
        cameras += [(name, 0, index.view(name)) for name in request.views]
        if "mask2d" in request.outputs:
            views = [posed for _, _, posed in cameras]
            check_pixels(views, len(request.texts))
            for posed in views:
                index.check_view(posed)
        asker = asker_of(index, request)
        ranked = self._context.known_names.suggesting(request.scene_id, index.ranked)
        size, field = _bytes_to_hold(index, cameras, request)
        with self._context.memory.reserve(size, field):
            ranked_query = RankedQuery(ranked, query) if subscription is None else subscription.ranked(ranked, query)
            return tuple(
                completed(
                    answer,
                    request,
                    version,
                    self._context.settings.calls,
                    masks=_masks(index, answer, cameras, request),
                    mask3d=encode_mask3d(index.mask3d(answer), request.mask3d_encoding, index.scene.gaussians)
                    if "mask3d" in request.outputs
                    else None,
                    objects=self._context.known_names.suggest(request.scene_id, index.ranked, index.objects_of(answer))
                    if "objects" in request.outputs
                    else None,
                )
                for answer in ranked_query.answer(lambda: index.objects, asker)
            )

    def _check(self, request: QueryRequest) -> TextQuery:
        query = check_query(
            request.texts,
            self._context.settings.query,
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
                '"mask2d" needs a camera or a view',
                field="cameras",
                hint="Send a pose, or the name of a view (view=NAME in an address).",
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
        limits = self._context.settings.query
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
    for view, number, posed in cameras:
        check_cancelled()
        masks.append(encoded_mask(index.mask(answer, posed), view, number, request.mask2d_encoding))
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
