"""The REST routes of scenes, their versions, and the operations that make them."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from fastsplat.api.access.caller import caller_id, caller_role
from fastsplat.api.operation_waits import MAX_WAIT_S, Operations
from fastsplat.api.rest.events import EVENT_SCHEMA, MEDIA_TYPE, operation_events
from fastsplat.api.rest.responses import PROBLEMS, json_of_call, json_response, run_cancellable, while_connected
from fastsplat.api.rest.upload import BODY_SCHEMA, receive_scene
from fastsplat.api.threads import Threads
from fastsplat.service.application.exporting.camera_files import MEDIA_TYPES
from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_contract.json_codec import to_json
from fastsplat_contract.look_again_messages import LookAgainIn
from fastsplat_contract.members import description_of
from fastsplat_contract.operations import Operation, OperationList, OperationState, RetryIn
from fastsplat_contract.photo_verdicts import PhotoVerdictList
from fastsplat_contract.queries import CameraFileRequest, CameraFormat
from fastsplat_contract.scenes import (
    AlignIn,
    Edit,
    EditIn,
    LabelList,
    ObjectList,
    RedoIn,
    RestoreIn,
    Scene,
    SceneList,
    SceneUpdate,
    SceneVersion,
    UndoIn,
    VersionList,
)
from fastsplat_contract.server_info import ServerInfo
from fastsplat_contract.server_status import ServerStatus
from fastsplat_contract.thing_messages import ThingList
from fastsplat_contract.train_more_messages import TrainMoreIn

_WAIT_BOUNDS: dict[str, Any] = {"minimum": 0, "maximum": MAX_WAIT_S}

PageSize = Annotated[int, Query(description="0: the server's default", json_schema_extra={"minimum": 0})]
PageToken = Annotated[str, Query(description="next_page_token of the page before")]
Version = Annotated[str, Query(description="of the scene; empty: the current one")]


def server_routes(info: ServerInfo, service: SceneService, threads: Threads) -> APIRouter:
    """The server itself."""
    router = APIRouter(prefix="/v1", responses=PROBLEMS)

    @router.get("/server", response_model=ServerInfo)
    async def get_server() -> Response:
        """The release that runs, and where its gRPC interface is."""
        return json_response(to_json(info))

    @router.get("/server/status", response_model=ServerStatus)
    async def get_server_status(request: Request) -> Response:
        """What the server can do, and how much room the project has left, as the caller may know it."""
        role, key_id = caller_role(), caller_id()
        return await json_of_call(request, threads.call, lambda: service.status(role, key_id))

    return router


def scene_routes(service: SceneService, settings: Settings, threads: Threads) -> APIRouter:
    """Scenes: post, look, list, edit, delete."""
    router = APIRouter(prefix="/v1", responses=PROBLEMS)

    def accepted(operation: Operation) -> Response:
        where = {"Location": f"{settings.root_path}/v1/operations/{operation.id}"}
        return json_response(to_json(operation), 202, where)

    @router.post("/scenes", status_code=202, response_model=Operation, openapi_extra=BODY_SCHEMA)
    async def create_scene(request: Request) -> Response:
        """Upload a capture and queue its training; the operation is durable once it is returned."""
        operation = await receive_scene(request, service, settings, threads)
        return accepted(operation)

    @router.get("/scenes", response_model=SceneList)
    async def list_scenes(request: Request, page_size: PageSize = 0, page_token: PageToken = "") -> Response:
        """Scenes in pages, newest first."""
        return await json_of_call(request, threads.call, lambda: service.list_scenes(page_size, page_token))

    @router.get("/scenes/{scene_id}", response_model=Scene)
    async def get_scene(request: Request, scene_id: str) -> Response:
        """One scene with its dictionary, cameras and quality."""
        return await json_of_call(request, threads.call, lambda: service.get_scene(scene_id))

    @router.patch("/scenes/{scene_id}", response_model=Scene)
    async def update_scene(request: Request, scene_id: str, body: SceneUpdate) -> Response:
        """Rename a scene."""
        return await json_of_call(request, threads.call, lambda: service.update_scene(scene_id, body))

    @router.delete("/scenes/{scene_id}", status_code=204, response_class=Response)
    async def delete_scene(scene_id: str) -> Response:
        """Forget a scene and all its files; its job stops."""
        await threads.call(lambda: service.delete_scene(scene_id))
        return Response(status_code=204)

    @router.get("/scenes/{scene_id}/labels", response_model=LabelList)
    async def list_labels(
        request: Request, scene_id: str, page_size: PageSize = 0, page_token: PageToken = ""
    ) -> Response:
        """The dictionary in pages, by label id."""
        return await json_of_call(request, threads.call, lambda: service.list_labels(scene_id, page_size, page_token))

    @router.get("/scenes/{scene_id}/photo-verdicts", response_model=PhotoVerdictList)
    async def list_photo_verdicts(
        request: Request, scene_id: str, page_size: PageSize = 0, page_token: PageToken = ""
    ) -> Response:
        """What became of each photo of a scene's capture, in pages, by name; once its capture stage is done."""
        return await json_of_call(
            request, threads.call, lambda: service.list_photo_verdicts(scene_id, page_size, page_token)
        )

    @router.get("/scenes/{scene_id}/objects", response_model=ObjectList)
    async def list_objects(
        request: Request,
        scene_id: str,
        label: Annotated[str, Query(description="only those of this dictionary entry; empty: all")] = "",
        version: Version = "",
        page_size: PageSize = 0,
        page_token: PageToken = "",
    ) -> Response:
        """The things of a scene as oriented boxes, in pages."""
        return await json_of_call(
            request,
            threads.answer,
            lambda: service.answers.list_objects(scene_id, version, label, page_size, page_token),
        )

    @router.get("/scenes/{scene_id}/things", response_model=ThingList)
    async def list_things(
        request: Request,
        scene_id: str,
        version: Version = "",
        page_size: PageSize = 0,
        page_token: PageToken = "",
        parts: Annotated[bool, Query(description="whether each thing is followed by its parts")] = False,
    ) -> Response:
        """Every thing of a scene, with or without a name, in pages, by id."""
        return await json_of_call(
            request,
            threads.answer,
            lambda: service.answers.list_things(scene_id, version, page_size, page_token, parts),
        )

    @router.get(
        "/scenes/{scene_id}/cameras",
        response_class=Response,
        responses={
            200: {
                "content": {
                    "application/json": {"schema": {"type": "object"}},
                    "application/zip": {"schema": {"type": "string", "format": "binary"}},
                },
                "description": "the file",
            }
        },
    )
    async def cameras(
        request: Request,
        scene_id: str,
        format: Annotated[
            CameraFormat,
            Query(description=description_of(CameraFileRequest, "format")),
        ] = "json",
    ) -> Response:
        """The scene's own cameras as a file."""
        if MEDIA_TYPES[format] == "application/json":
            file = partial(service.camera_file, scene_id, format)
            return await json_of_call(request, threads.call, file, encode=lambda content: content)
        content = await run_cancellable(request, threads.call, lambda: service.camera_file(scene_id, format))
        return Response(content, media_type=MEDIA_TYPES[format])

    @router.post("/scenes/{scene_id}:edit", response_model=SceneVersion)
    async def edit_scene(request: Request, scene_id: str, body: EditIn) -> Response:
        """Make a new version of a scene: the edits in order, all or none; it is current on return."""
        return await json_of_call(
            request,
            threads.call,
            lambda: service.versions.edit(scene_id, body.edits, body.request_id, body.version, caller_id()),
        )

    @router.post("/scenes/{scene_id}:lookAgain", status_code=202, response_model=Operation)
    async def look_again(request: Request, scene_id: str, body: LookAgainIn) -> Response:
        """Search a scene for more names with the server's open-set detector: an operation that makes a version."""
        operation = await run_cancellable(request, threads.call, lambda: service.look_again(scene_id, body))
        return accepted(operation)

    @router.post("/scenes/{scene_id}:trainMore", status_code=202, response_model=Operation)
    async def train_more(request: Request, scene_id: str, body: TrainMoreIn) -> Response:
        """Train a scene further, from where it is, with the photos kept with it: an operation that makes a version."""
        operation = await run_cancellable(request, threads.call, lambda: service.training.order(scene_id, body))
        return accepted(operation)

    @router.post("/scenes/{scene_id}:align", response_model=SceneVersion)
    async def align_scene(request: Request, scene_id: str, body: AlignIn) -> Response:
        """Put a scene into the frame of a map, by a rigid motion or by pairs of points, as a new version."""
        edits = (Edit("align", alignment=body.alignment),)
        return await json_of_call(
            request, threads.call, lambda: service.versions.edit(scene_id, edits, body.request_id, "", caller_id())
        )

    @router.post("/scenes/{scene_id}:undo", response_model=SceneVersion)
    async def undo_edit(request: Request, scene_id: str, body: UndoIn | None = None) -> Response:
        """Go back to the version before the current one."""
        expected = body.version if body is not None else ""
        return await json_of_call(request, threads.call, lambda: service.versions.undo(scene_id, expected))

    @router.post("/scenes/{scene_id}:redo", response_model=SceneVersion)
    async def redo_edit(request: Request, scene_id: str, body: RedoIn | None = None) -> Response:
        """Go forward to the version that was undone: of several made of the current one, the one current last."""
        expected = body.version if body is not None else ""
        return await json_of_call(request, threads.call, lambda: service.versions.redo(scene_id, expected))

    @router.post("/scenes/{scene_id}:restore", response_model=SceneVersion)
    async def restore_version(request: Request, scene_id: str, body: RestoreIn) -> Response:
        """Make any version of a scene the current one; all others stay."""
        return await json_of_call(
            request, threads.call, lambda: service.versions.restore(scene_id, body.version, body.expected)
        )

    @router.get("/scenes/{scene_id}/versions", response_model=VersionList)
    async def list_versions(request: Request, scene_id: str) -> Response:
        """Every version of a scene, oldest first."""
        return await json_of_call(request, threads.call, lambda: VersionList(service.versions.all(scene_id)))

    return router


def operation_routes(service: SceneService, threads: Threads) -> APIRouter:
    """The jobs that make scenes: look, list, wait, watch, cancel."""
    router = APIRouter(prefix="/v1", responses=PROBLEMS)

    operations = Operations(service, threads)

    @router.get("/operations", response_model=OperationList)
    async def list_operations(
        request: Request,
        page_size: PageSize = 0,
        page_token: PageToken = "",
        state: Annotated[OperationState | None, Query(description="only those in this state")] = None,
    ) -> Response:
        """Operations in pages, newest first."""
        return await json_of_call(request, threads.call, lambda: service.list_operations(page_size, page_token, state))

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

    @router.get("/operations/{operation_id}", response_model=Operation)
    async def get_operation(request: Request, operation_id: str) -> Response:
        """Where a job stands, stage by stage."""
        return await json_of_call(request, threads.call, lambda: service.get_operation(operation_id))

    @router.post("/operations/{operation_id}:cancel", response_model=Operation)
    async def cancel_operation(request: Request, operation_id: str) -> Response:
        """Ask a job to stop; one that is over stays as it is."""
        return await json_of_call(request, threads.call, lambda: service.cancel_operation(operation_id))

    @router.post("/operations/{operation_id}:retry", response_model=Operation)
    async def retry_operation(request: Request, operation_id: str, body: RetryIn | None = None) -> Response:
        """Queue a failed or cancelled job again, with the upload that it had, or with less of it; one in another state
        stays as it is."""
        exclude = body.exclude if body is not None else ()
        return await json_of_call(request, threads.call, lambda: service.retry_operation(operation_id, exclude))

    return router
