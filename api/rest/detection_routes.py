"""The REST route of a scene's things as robots need them."""

from __future__ import annotations

from fastapi import APIRouter, Request
from starlette.responses import Response

from fastsplat.api.rest.responses import PROBLEMS, json_of_call
from fastsplat.api.rest.routes import PageSize, PageToken, Version
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.detection_messages import DetectionList


def detection_routes(service: SceneService, threads: Threads) -> APIRouter:
    """Things of finished scenes as robots need them."""
    router = APIRouter(prefix="/v1", responses=PROBLEMS)

    @router.get("/scenes/{scene_id}/detections", response_model=DetectionList)
    async def list_detections(
        request: Request, scene_id: str, version: Version = "", page_size: PageSize = 0, page_token: PageToken = ""
    ) -> Response:
        """The things of a scene in pages, by id: poses with covariances, names with probabilities, what carries them,
        and by which views they are known."""
        return await json_of_call(
            request, threads.answer, lambda: service.detections.all(scene_id, version, page_size, page_token)
        )

    return router
