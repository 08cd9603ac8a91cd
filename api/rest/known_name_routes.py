"""The REST routes of what people named in a project."""

from __future__ import annotations

from fastapi import APIRouter, Request
from starlette.responses import Response

from fastsplat.api.rest.responses import PROBLEMS, json_of_call
from fastsplat.api.rest.routes import PageSize, PageToken
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.known_names import KnownNameList


def known_name_routes(service: SceneService, threads: Threads) -> APIRouter:
    """Known names of the caller's project: list, delete."""
    router = APIRouter(prefix="/v1", responses=PROBLEMS)

    @router.get("/known-names", response_model=KnownNameList)
    async def list_known_names(request: Request, page_size: PageSize = 0, page_token: PageToken = "") -> Response:
        """What people named in the scenes of the project and is suggested in others, in pages, newest first."""
        return await json_of_call(request, threads.call, lambda: service.known_names.list(page_size, page_token))

    @router.delete("/known-names/{name_id}", status_code=204, response_class=Response)
    async def delete_known_name(name_id: str) -> Response:
        """Suggest a name no more, and remove what it looks like; its scene keeps the name."""
        await threads.call(lambda: service.known_names.forget(name_id))
        return Response(status_code=204)

    @router.delete("/known-names", status_code=204, response_class=Response)
    async def delete_known_names() -> Response:
        """Suggest no name of the project any more, and remove what they look like; its scenes keep the names."""
        await threads.call(service.known_names.forget_all)
        return Response(status_code=204)

    return router
