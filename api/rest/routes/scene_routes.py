"""REST routes of scenes and jobs that are forms, files or streams."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from fastsplat.api.operation_waits import MAX_WAIT_S, Operations
from fastsplat.api.rest.responses import PROBLEMS, accepted, file_response, json_response, while_connected
from fastsplat.api.rest.routes.events import EVENT_SCHEMA, MEDIA_TYPE, operation_events
from fastsplat.api.rest.routes.upload import BODY_SCHEMA, receive_scene
from fastsplat.api.rest.standard_http import etag_of, not_modified
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_contract.codec.json_codec import to_json
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.server.server_info import ServerInfo

_STEP_HEADER = "X-Fastsplat-Step"
_WAIT_BOUNDS: dict[str, Any] = {"minimum": 0, "maximum": MAX_WAIT_S}

Version = Annotated[str, Query(description="of the scene; empty: the current one")]


def server_routes(info: ServerInfo) -> APIRouter:
    """Builds the route of the server's release."""
    router = APIRouter(prefix="/v1", responses=PROBLEMS)

    @router.get("/server", response_model=ServerInfo)
    async def get_server() -> Response:
        """The release that runs, and where its gRPC interface is."""
        return json_response(to_json(info))

    return router


def scene_routes(service: SceneService, settings: Settings, threads: Threads) -> APIRouter:
    """Builds the route of scene uploads."""
    router = APIRouter(prefix="/v1", responses=PROBLEMS)

    @router.post("/scenes", status_code=202, response_model=Operation, openapi_extra=BODY_SCHEMA)
    async def create_scene(request: Request) -> Response:
        """Upload a capture and queue its training; the operation is durable once it is returned."""
        operation = await receive_scene(request, service, settings, threads)
        return accepted(operation, settings.root_path)

    return router


def operation_routes(service: SceneService, threads: Threads) -> APIRouter:
    """Builds the routes that wait for, watch and preview jobs."""
    router = APIRouter(prefix="/v1", responses=PROBLEMS)

    operations = Operations(service, threads)

    @router.get("/operations/{operation_id}:wait", response_model=Operation)
    async def wait_operation(
        request: Request,
        operation_id: str,
        timeout_s: Annotated[
            float, Query(description="seconds to wait at most", json_schema_extra=_WAIT_BOUNDS)
        ] = 30.0,
    ) -> Response:
        """The operation as soon as it is done, or as it stands when the time is up."""
        return json_response(to_json(await while_connected(request, operations.wait(operation_id, timeout_s))))

    @router.get(
        "/operations/{operation_id}/events",
        response_class=Response,
        responses={
            200: {"content": {MEDIA_TYPE: {"schema": EVENT_SCHEMA}}, "description": "server-sent events"},
            204: {"description": "the operation is done, and Last-Event-ID says that this is known"},
        },
    )
    async def watch_operation(request: Request, operation_id: str) -> Response:
        """The operation now and on every change, until it is done; `Last-Event-ID` continues."""
        return await operation_events(request, operations, operation_id)

    @router.get(
        "/operations/{operation_id}/preview.jpg",
        response_class=Response,
        responses=file_response("image/jpeg", description=f"the picture; {_STEP_HEADER} says of which step"),
    )
    async def get_preview_picture(request: Request, operation_id: str) -> Response:
        """The newest picture of a scene that is being trained, as JPEG."""
        preview = await while_connected(request, threads.call(lambda: service.jobs.preview(operation_id)))
        headers = {
            "ETag": etag_of(preview.picture),
            "Cache-Control": "private, no-cache",
            _STEP_HEADER: str(preview.info.step),
        }
        unchanged = not_modified(request, headers)
        return Response(preview.picture, headers=headers, media_type="image/jpeg") if unchanged is None else unchanged

    return router
