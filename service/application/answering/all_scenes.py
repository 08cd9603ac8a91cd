"""Search over all scenes of a project; only answers that need Gaussians open a scene."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable

import numpy as np

from fastsplat.service.application.answering.mask_encodings import encode_mask3d
from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.base.memory import mask3d_bytes
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.language.words.query_text import TextQuery
from fastsplat.service.query.ranked_scene import RankedQuery
from fastsplat.service.settings import CallSettings
from fastsplat_contract.errors import (
    ArtefactError,
    InvalidInputError,
    ModelUnavailableError,
    NotFoundError,
    NotReadyError,
    ObjectStoreError,
    SceneFileError,
)
from fastsplat_contract.masks import ViewMask
from fastsplat_contract.messages.objects import SceneObject
from fastsplat_contract.messages.queries import Answer, QueryOut, QueryRequest, SkippedScene

_log = logging.getLogger(__name__)

MAX_SKIPPED = 1_000
_OF_GAUSSIANS = frozenset({"mask3d", "objects"})

AskOne = Callable[[TextQuery, QueryRequest], tuple[Answer, ...]]
"""Answers one scene, opening it for any output."""


class AllScenes:
    """Queries to all scenes of one project."""

    def __init__(self, context: ProjectContext, ask_one: AskOne) -> None:
        self._context = context
        self._ask_one = ask_one

    def query(self, query: TextQuery, request: QueryRequest) -> QueryOut:
        """Answers of the READY scenes, newest first, and the skipped ones.

        Damaged scenes and those over the limit are reported as skipped; scenes deleted meanwhile are not.

        Raises:
            InvalidInputError: the request has options of a single scene.
            LimitExceededError, CancelledError: as `Answers.query`.
        """
        _check_everywhere(request)
        scene_ids = self._context.store.scenes.ready_scene_ids()
        limit = self._context.settings.calls.max_queried_scenes
        answers: list[Answer] = []
        skipped: list[SkippedScene] = []
        for scene_id in scene_ids[:limit]:
            check_cancelled()
            try:
                answers += self._ask(query, dataclasses.replace(request, scene_id=scene_id))
            except (NotFoundError, NotReadyError):
                continue  # deleted since it was listed
            except (SceneFileError, ArtefactError, ObjectStoreError, ModelUnavailableError) as error:
                _log.warning("scene %s is left out of a question to several: %s", scene_id, error)
                skipped.append(SkippedScene(scene_id, error.reason, error.message))
        over = f"the {limit} newest scenes were asked (FASTSPLAT_CALLS__MAX_QUERIED_SCENES)"
        skipped += (SkippedScene(scene_id, "OVER_LIMIT", over) for scene_id in scene_ids[limit:])
        return QueryOut(tuple(answers), tuple(skipped[:MAX_SKIPPED]), len(skipped))

    def _ask(self, query: TextQuery, request: QueryRequest) -> tuple[Answer, ...]:
        """Answers of one scene; masks and objects need its Gaussians unless all are "absent"."""
        version, ranked = self._context.scenes.ranked(request.scene_id)
        answers = RankedQuery(self._context.known_names.suggesting(request.scene_id, ranked), query).answer(
            lambda: self._context.scenes.open(request.scene_id, version)[0].objects
        )
        present = any(answer.shows_something for answer in answers)
        if present and not _OF_GAUSSIANS.isdisjoint(request.outputs):
            return self._ask_one(query, dataclasses.replace(request, version=version))
        mask3d = None
        if "mask3d" in request.outputs:
            with self._context.memory.reserve(
                mask3d_bytes(request.mask3d_encoding, len(answers), ranked.blank), "texts"
            ):
                nothing = np.zeros(len(ranked.blank), dtype=np.bool_)
                mask3d = encode_mask3d(nothing, request.mask3d_encoding, ranked.blank)
        objects = () if "objects" in request.outputs else None
        return tuple(
            completed(answer, request, version, self._context.settings.calls, mask3d=mask3d, objects=objects)
            for answer in answers
        )


def completed(
    answer: Answer,
    request: QueryRequest,
    version: str,
    calls: CallSettings,
    *,
    masks: tuple[ViewMask, ...] = (),
    mask3d: bytes | None = None,
    objects: tuple[SceneObject, ...] | None = None,
) -> Answer:
    """Completes an answer with scene, version, outputs, and the number of matches to show."""
    limit = calls.max_matches if request.max_matches == 0 else request.max_matches
    return dataclasses.replace(
        answer,
        object_ids=answer.object_ids or tuple(obj.id for obj in objects or ()),
        scene_id=request.scene_id,
        version=version,
        matches=answer.matches if limit < 0 else answer.matches[:limit],
        masks=masks,
        mask3d=mask3d,
        objects=objects,
    )


def _check_everywhere(request: QueryRequest) -> None:
    """Rejects options of a single scene."""
    if "mask2d" in request.outputs:
        raise InvalidInputError(
            '"mask2d" needs one scene: cameras belong to a scene', field="outputs", hint="Name the scene."
        )
    if request.cameras or request.views or request.asker is not None or request.asker_view is not None:
        raise InvalidInputError(
            "cameras, views and where the asker stands belong to one scene",
            field="scene_id",
            hint="Name the scene to ask.",
        )
    if request.version:
        raise InvalidInputError("a version belongs to one scene", field="scene_id", hint="Name the scene to ask.")
