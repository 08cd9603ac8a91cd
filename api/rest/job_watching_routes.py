"""The REST routes of what jobs show of their scenes while they run, and of ending one early."""

from __future__ import annotations

from fastapi import APIRouter, Request
from starlette.responses import Response

from fastsplat.api.rest.responses import PROBLEMS, file_response, json_of_call, run_cancellable
from fastsplat.api.rest.standard_http import etag_of, not_modified
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.job_watching import PlacedCameras, Preview
from fastsplat_contract.operations import Operation

_STEP_HEADER = "X-Fastsplat-Step"


def job_watching_routes(service: SceneService, threads: Threads) -> APIRouter:
    """Jobs that run: pictures, cameras, an early end."""
    router = APIRouter(prefix="/v1", responses=PROBLEMS)

    @router.post("/operations/{operation_id}:finish", response_model=Operation)
    async def finish_operation(request: Request, operation_id: str) -> Response:
        """Ask a job to end its training early, and to make the scene of what is there; asked again nothing changes."""
        return await json_of_call(request, threads.call, lambda: service.jobs.finish(operation_id))

    @router.get("/operations/{operation_id}/preview", response_model=Preview)
    async def get_preview(request: Request, operation_id: str) -> Response:
        """The newest picture of a scene that is being trained, with its step and figures."""
        return await json_of_call(request, threads.call, lambda: service.jobs.preview(operation_id))

    @router.get(
        "/operations/{operation_id}/preview.jpg",
        response_class=Response,
        responses=file_response("image/jpeg", description=f"the picture; {_STEP_HEADER} says of which step"),
    )
    async def get_preview_picture(request: Request, operation_id: str) -> Response:
        """The newest picture of a scene that is being trained, as JPEG."""
        preview = await run_cancellable(request, threads.call, lambda: service.jobs.preview(operation_id))
        headers = {
            "ETag": etag_of(preview.picture),
            "Cache-Control": "private, no-cache",
            _STEP_HEADER: str(preview.info.step),
        }
        unchanged = not_modified(request, headers)
        return Response(preview.picture, headers=headers, media_type="image/jpeg") if unchanged is None else unchanged

    @router.get("/operations/{operation_id}/cameras", response_model=PlacedCameras)
    async def get_placed_cameras(request: Request, operation_id: str) -> Response:
        """The cameras that a job has placed so far, and some of its points."""
        return await json_of_call(request, threads.call, lambda: service.jobs.placed_cameras(operation_id))

    return router
