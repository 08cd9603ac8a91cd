"""Questions to finished scenes: which artefact, asked what, in which form."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from fastsplat.service.application.mask_encodings import encode_mask3d, mask_ply, view_mask
from fastsplat.service.application.open_scenes import OpenScenes, view_of
from fastsplat.service.application.paging import page_of
from fastsplat.service.application.pictures import picture, question_of
from fastsplat.service.application.validate import check_page_size
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query import SceneIndex
from fastsplat.service.query.query_text import TextQuery, check_query
from fastsplat.service.settings import Settings
from fastsplat.service.store import Store
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, NotFoundError
from fastsplat_contract.queries import Answer, PictureRequest, QueryRequest
from fastsplat_contract.scenes import ObjectList


class Answers:
    """What can be asked of finished scenes; see `SceneService` for each call."""

    def __init__(self, store: Store, settings: Settings, scenes: OpenScenes) -> None:
        self._store = store
        self._settings = settings
        self._scenes = scenes

    def query(self, request: QueryRequest) -> tuple[Answer, ...]:
        """One answer a text, of one scene or of every READY one; raises as `SceneService.query`."""
        query = self._check(request)
        if request.scene_id:
            return self._ask(query, request)
        _check_everywhere(request)
        answers: list[Answer] = []
        for scene_id in self._store.scenes.ready_scene_ids():
            check_cancelled()
            try:
                answers.extend(self._ask(query, dataclasses.replace(request, scene_id=scene_id)))
            except NotFoundError:
                continue  # deleted since it was listed
        return tuple(answers)

    def picture(self, request: PictureRequest) -> bytes:
        """The bytes of one picture; raises as `SceneService.view_picture`."""
        question = question_of(request)
        query = check_query((question,), self._settings.query) if question else None
        return self._scenes.reading(request.scene_id, request.version, lambda index, _: picture(index, request, query))

    def scene_ply(self, scene_id: str, version: str) -> tuple[Path, str]:
        """The scene's PLY file and its version; raises as `SceneService.scene_ply`."""
        version = self._scenes.version(scene_id, version)
        path = self._scenes.folder(scene_id, version) / "scene.ply"
        if not path.is_file():
            raise NotFoundError(f"scene {scene_id!r} was deleted meanwhile", field="scene")
        return path, version

    def mask_ply(self, scene_id: str, text: str, version: str) -> bytes:
        """The PLY of the Gaussians that answer a text; raises as `SceneService.mask_ply`."""
        query = check_query((text,), self._settings.query)

        def read(index: SceneIndex, _: str) -> bytes:
            (answer,) = index.answer(query)
            return mask_ply(index.scene.gaussians, index.mask3d(answer))

        return self._scenes.reading(scene_id, version, read)

    def objects(self, scene_id: str, version: str, label: str, page_size: int, page_token: str) -> ObjectList:
        """One page of a scene's objects; raises as `SceneService.list_objects`."""
        size = check_page_size(page_size, self._settings.store)

        def read(index: SceneIndex, read_version: str) -> ObjectList:
            objects = index.objects
            if label:
                label_id = index.scene.dictionary.id_of(label)
                if label_id is None:
                    raise NotFoundError(
                        f"no label {label[:80]!r} in this scene", field="label", hint="List its labels, or ask a query."
                    )
                objects = tuple(thing for thing in objects if thing.label_id == label_id)
            page, token = page_of(objects, size, page_token, f"objects {scene_id} {read_version} {label}")
            return ObjectList(tuple(page), token, read_version)

        return self._scenes.reading(scene_id, version, read)

    def _ask(self, query: TextQuery, request: QueryRequest) -> tuple[Answer, ...]:
        return self._scenes.reading(
            request.scene_id, request.version, lambda index, version: self._answer(index, version, query, request)
        )

    def _answer(self, index: SceneIndex, version: str, query: TextQuery, request: QueryRequest) -> tuple[Answer, ...]:
        cameras = [("", number, posed) for number, posed in enumerate(request.cameras)]
        cameras += [(name, 0, view_of(index, name)) for name in request.views]
        shown = self._settings.calls.max_matches if request.max_matches == 0 else request.max_matches
        answers: list[Answer] = []
        for answer in index.answer(query):
            masks = []
            for camera in cameras if "mask2d" in request.outputs else ():
                check_cancelled()
                masks.append(view_mask(index, answer, *camera, request.mask2d_encoding))
            mask3d = None
            if "mask3d" in request.outputs:
                mask3d = encode_mask3d(index.mask3d(answer), request.mask3d_encoding, index.scene.gaussians)
            answers.append(
                dataclasses.replace(
                    answer,
                    scene_id=request.scene_id,
                    version=version,
                    matches=answer.matches if shown < 0 else answer.matches[:shown],
                    masks=tuple(masks),
                    mask3d=mask3d,
                    objects=index.objects_of(answer) if "objects" in request.outputs else None,
                )
            )
        return tuple(answers)

    def _check(self, request: QueryRequest) -> TextQuery:
        query = check_query(
            request.texts,
            self._settings.query,
            negatives=request.negatives or None,
            templates=request.templates or None,
            coverage=request.coverage,
        )
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
                limit=f"{limits.max_poses} cameras (FASTSPLAT_QUERY__MAX_POSES)",
                hint="Ask in several requests.",
            )
        return query


def _check_everywhere(request: QueryRequest) -> None:
    """Refuse what belongs to one scene."""
    if "mask2d" in request.outputs:
        raise InvalidInputError(
            '"mask2d" needs one scene: cameras belong to a scene', field="outputs", hint="Name the scene."
        )
    if request.cameras or request.views:
        raise InvalidInputError(
            "cameras and views belong to one scene", field="scene_id", hint="Name the scene to ask."
        )
    if request.version:
        raise InvalidInputError("a version belongs to one scene", field="scene_id", hint="Name the scene to ask.")
