"""The REST routes; each is one service call on a thread."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request
from fastapi import Path as PathParameter
from pydantic import BaseModel
from starlette.responses import FileResponse, Response

from api.rest import models
from api.rest.problems import PROBLEM_RESPONSE
from api.rest.translate import answer_out, camera_in, operation_out, query_in, scene_out, summary_out
from api.rest.upload import BODY_SCHEMA, receive_scene
from api.threads import Threads
from service.calls.service import SceneService
from service.calls.types import QueryAnswer, QueryRequest
from service.settings import Settings

_POLL_S = 0.25
_PLY = "application/x-ply"
_PROBLEMS: dict[int | str, dict[str, Any]] = {"4XX": PROBLEM_RESPONSE, "5XX": PROBLEM_RESPONSE}

_Text = Annotated[str, Query(description="the question")]
_Kind = Annotated[
    Literal["rgb", "overlay", "relevancy", "mask"],
    PathParameter(description="the view, the answer's mask over it, relevancy in turbo colours, or the mask (0, 255)"),
]


def _file(media_type: str, description: str) -> dict[int | str, dict[str, Any]]:
    schema = {"type": "string", "format": "binary"}
    return {200: {"content": {media_type: {"schema": schema}}, "description": description}}


def scene_routes(service: SceneService, settings: Settings, threads: Threads) -> APIRouter:
    """Scenes and the operations that make them."""
    router = APIRouter(prefix="/v1", responses=_PROBLEMS)

    async def answered(function: Callable[[], BaseModel], status: int = 200) -> Response:
        return await _answered(threads, function, status)

    @router.post("/scenes", status_code=202, response_model=models.Operation, openapi_extra=BODY_SCHEMA)
    async def create_scene(request: Request) -> Response:
        """Upload a capture and queue its training; the operation is durable once it is returned."""
        operation = await receive_scene(request, service, settings, threads)
        body = operation_out(operation)
        location = {"Location": f"/v1/operations/{operation.id}"}
        return Response(body.model_dump_json(), 202, headers=location, media_type="application/json")

    @router.get("/scenes", response_model=models.SceneList)
    async def list_scenes(
        page_size: Annotated[int, Query(description="0: the server's default")] = 0,
        page_token: Annotated[str, Query(description="next_page_token of the page before")] = "",
    ) -> Response:
        """Scenes in pages, newest first."""

        def listed() -> models.SceneList:
            page, token = service.list_scenes(page_size, page_token)
            return models.SceneList(scenes=[summary_out(scene) for scene in page], next_page_token=token)

        return await answered(listed)

    @router.get("/scenes/{scene_id}", response_model=models.Scene)
    async def get_scene(scene_id: str) -> Response:
        """One scene with its dictionary, cameras and quality."""
        return await answered(lambda: scene_out(service.get_scene(scene_id)))

    @router.delete("/scenes/{scene_id}", status_code=204, response_class=Response)
    async def delete_scene(scene_id: str) -> Response:
        """Forget a scene and all its files; its job stops."""
        await threads.call(lambda: service.delete_scene(scene_id))
        return Response(status_code=204)

    @router.get("/operations/{operation_id}:wait", response_model=models.Operation)
    async def wait_operation(
        operation_id: str,
        timeout_s: Annotated[float, Query(ge=0, le=300, description="seconds to wait at most")] = 30.0,
    ) -> Response:
        """The operation as soon as it is done, or as it stands when the time is up."""
        deadline = asyncio.get_running_loop().time() + timeout_s
        while True:
            operation = operation_out(await threads.call(lambda: service.get_operation(operation_id)))
            left = deadline - asyncio.get_running_loop().time()
            if operation.done or left <= 0:
                return Response(operation.model_dump_json(), media_type="application/json")
            await asyncio.sleep(min(_POLL_S, left))

    @router.get("/operations/{operation_id}", response_model=models.Operation)
    async def get_operation(operation_id: str) -> Response:
        """Where a job stands, stage by stage."""
        return await answered(lambda: operation_out(service.get_operation(operation_id)))

    @router.post("/operations/{operation_id}:cancel", response_model=models.Operation)
    async def cancel_operation(operation_id: str) -> Response:
        """Ask a job to stop; one that is over stays as it is."""
        return await answered(lambda: operation_out(service.cancel_operation(operation_id)))

    return router


def query_routes(service: SceneService, threads: Threads) -> APIRouter:
    """Questions, pictures and files of finished scenes."""
    router = APIRouter(responses=_PROBLEMS)

    @router.get("/query", response_model=models.QueryOut)
    async def query(
        text: Annotated[list[str], Query(description="the question; several are allowed")],
        scene: Annotated[str, Query(description="scene id; empty: all ready scenes, newest first")] = "",
    ) -> Response:
        """Ranked labels for a text, in one scene or in all."""
        texts = tuple(text)

        def asked() -> models.QueryOut:
            found = service.query(QueryRequest(scene, texts)) if scene else service.query_all(texts)
            return _query_out(found, with_mask3d=False)

        return await _answered(threads, asked)

    @router.post("/v1/scenes/{scene_id}:query", response_model=models.QueryOut)
    async def query_scene(scene_id: str, query: models.QueryIn) -> Response:
        """Ranked labels, 2D masks at poses or views, and 3D masks."""
        with_mask3d = "mask3d" in query.outputs
        return await _answered(
            threads, lambda: _query_out(service.query(query_in(scene_id, query)), with_mask3d=with_mask3d)
        )

    @router.get(
        "/v1/scenes/{scene_id}/{kind}.png", response_class=Response, responses=_file("image/png", "the picture")
    )
    async def view_picture(
        scene_id: str,
        kind: _Kind,
        view: Annotated[str, Query(description="name of one of the scene's cameras")],
        text: Annotated[str | None, Query(description="the question; every kind but rgb needs one")] = None,
    ) -> Response:
        """A picture from one of the scene's own cameras."""
        png = await threads.call(lambda: service.view_picture(scene_id, text or None, kind, None, view))
        return Response(png, media_type="image/png")

    @router.post("/v1/scenes/{scene_id}:render", response_class=Response, responses=_file("image/png", "the picture"))
    async def render(scene_id: str, wanted: models.RenderIn) -> Response:
        """A picture from a free viewpoint, or from one of the scene's own cameras."""

        def rendered() -> bytes:
            camera = None if wanted.camera is None else camera_in(wanted.camera, "camera")
            return service.view_picture(scene_id, wanted.text or None, wanted.kind, camera, wanted.view)

        return Response(await threads.call(rendered), media_type="image/png")

    @router.get("/v1/scenes/{scene_id}/scene.ply", response_class=FileResponse, responses=_file(_PLY, "3DGS PLY"))
    async def scene_ply(scene_id: str) -> Response:
        """The whole scene as a standard 3DGS PLY; Range and ETag are understood."""
        path = await threads.call(lambda: service.scene_ply(scene_id))
        return FileResponse(path, media_type=_PLY, filename="scene.ply")

    @router.get("/v1/scenes/{scene_id}/mask.ply", response_class=Response, responses=_file(_PLY, "3DGS PLY"))
    async def mask_ply(scene_id: str, text: _Text) -> Response:
        """Only the Gaussians that answer the text, as a 3DGS PLY."""
        ply = await threads.call(lambda: service.mask_ply(scene_id, text))
        return Response(ply, media_type=_PLY, headers={"Content-Disposition": 'attachment; filename="mask.ply"'})

    @router.get(
        "/v1/scenes/{scene_id}/mask3d.bin",
        response_class=Response,
        responses=_file("application/octet-stream", "⌈G/8⌉ bytes; G stands in X-Gaussian-Count"),
    )
    async def mask3d(scene_id: str, text: _Text) -> Response:
        """One bit per Gaussian in row order, most significant bit first: which of them answer the text."""

        def packed() -> tuple[bytes, int]:
            (answer,) = service.query(QueryRequest(scene_id, (text,), outputs=frozenset({"mask3d"})))
            return answer.mask3d, service.get_scene(scene_id).gaussians

        mask, gaussians = await threads.call(packed)
        return Response(mask, media_type="application/octet-stream", headers={"X-Gaussian-Count": str(gaussians)})

    return router


def health_routes(service: SceneService, threads: Threads) -> APIRouter:
    """Whether the process lives, and whether it can answer."""
    router = APIRouter()

    @router.get("/livez")
    async def livez() -> dict[str, str]:
        """The process runs its event loop."""
        return {"status": "ok"}

    @router.get("/readyz", responses=_PROBLEMS)
    async def readyz() -> dict[str, str]:
        """The database answers."""
        await threads.call(lambda: service.list_scenes(1, ""))
        return {"status": "ok"}

    return router


async def _answered(threads: Threads, function: Callable[[], BaseModel], status: int = 200) -> Response:
    """Call, translate and serialise on the thread: a large answer must not hold up the event loop."""
    body = await threads.call(lambda: function().model_dump_json())
    return Response(body, status, media_type="application/json")


def _query_out(answers: tuple[QueryAnswer, ...], *, with_mask3d: bool) -> models.QueryOut:
    return models.QueryOut(answers=[answer_out(answer, with_mask3d=with_mask3d) for answer in answers])
