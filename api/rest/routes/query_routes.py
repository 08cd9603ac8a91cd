"""REST routes of questions and pictures."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request
from fastapi import Path as PathParameter
from starlette.responses import Response

from fastsplat.api.rest.responses import PROBLEMS, UNCHANGED, file_response, json_of_call, while_connected
from fastsplat.api.rest.routes.scene_routes import Version
from fastsplat.api.rest.routes.table_routes import query_parameters, with_parameters
from fastsplat.api.rest.standard_http import etag_of, not_modified
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.codec.json_codec import from_plain
from fastsplat_contract.codec.members import description_of, members
from fastsplat_contract.messages.queries import QueryIn, QueryOut, QueryRequest
from fastsplat_contract.photos.pictures import PictureFormat, PictureKind, PictureRequest, RenderIn

_MEDIA_TYPES: dict[PictureFormat, str] = {"png": "image/png", "npy": "application/octet-stream", "jpeg": "image/jpeg"}
_OF_VIEWS: dict[PictureFormat, str] = {"png": "view_picture", "npy": "view_array"}

_Text = Annotated[str, Query(description="the question")]
_IN_ADDRESS = {
    member.name: {"texts": "text", "scene_id": "scene", "views": "view"}.get(member.name, member.name)
    for member in members(QueryRequest)
    if member.name not in ("cameras", "asker")
}
"""Query parameters of `GET /query` by member of the request."""


def query_routes(service: SceneService, threads: Threads) -> APIRouter:
    """Builds the routes of questions and pictures."""
    router = APIRouter(responses=PROBLEMS)

    def own_view(extension: PictureFormat) -> Callable[..., Awaitable[Response]]:
        async def endpoint(
            request: Request,
            scene_id: str,
            kind: Annotated[PictureKind, PathParameter(description=description_of(RenderIn, "kind"))],
            view: Annotated[str, Query(description=description_of(RenderIn, "view"))],
            text: Annotated[str | None, Query(description=description_of(RenderIn, "text"))] = None,
            version: Version = "",
            depth_scale: Annotated[float, Query(ge=0, description=description_of(RenderIn, "depth_scale"))] = 0.0,
        ) -> Response:
            """What one of the scene's own cameras sees."""
            exact, headers = await tagged(extension, scene_id, version, kind, view, text, depth_scale)
            if (unchanged := not_modified(request, headers)) is not None:
                return unchanged
            more: Any = {"view": view, "version": exact, "format": extension, "depth_scale": depth_scale}
            return await drawn(request, PictureRequest(scene_id, kind, text, **more), headers)

        return endpoint

    async def drawn(request: Request, picture: PictureRequest, headers: dict[str, str] | None = None) -> Response:
        work = threads.answer(lambda: service.answers.picture(picture), background=True)
        return Response(await while_connected(request, work), headers=headers, media_type=_MEDIA_TYPES[picture.format])

    async def tagged(name: str, scene_id: str, version: str, *question: object) -> tuple[str, dict[str, str]]:
        """Resolves the version and builds the headers of its immutable answer."""
        exact = await threads.call(lambda: service.versions.resolve(scene_id, version))
        return exact, {"ETag": etag_of(name, scene_id, exact, *question), "Cache-Control": "private, no-cache"}

    async def query(request: Request, **sent: Any) -> Response:
        """Ranked labels for a text, in one scene or in all of the project; masks of the views that are named."""
        question = from_plain(QueryRequest, {member: sent[name] for member, name in _IN_ADDRESS.items()})
        return await answered(request, question)

    def answered(request: Request, question: QueryRequest) -> Awaitable[Response]:
        run = partial(threads.answer, background="mask2d" in question.outputs)
        return json_of_call(request, run, partial(service.answers.query, question))

    parameters = query_parameters(QueryRequest, _IN_ADDRESS, scene="")
    router.add_api_route("/query", with_parameters(query, parameters), methods=["GET"], response_model=QueryOut)

    @router.post("/v1/scenes/{scene_id}:query", response_model=QueryOut)
    async def query_scene(request: Request, scene_id: str, body: QueryIn) -> Response:
        """Ranked labels, 2D masks at poses or views, 3D masks, and objects."""
        return await answered(request, QueryRequest(scene_id, **vars(body)))

    for extension, name in _OF_VIEWS.items():
        path, endpoint = f"/v1/scenes/{{scene_id}}/{{kind}}.{extension}", own_view(extension)
        responses = {**file_response(_MEDIA_TYPES[extension], description="the picture"), **UNCHANGED}
        router.add_api_route(path, endpoint, name=name, response_class=Response, responses=responses)

    @router.post(
        "/v1/scenes/{scene_id}:render",
        response_class=Response,
        responses=file_response(*_MEDIA_TYPES.values(), description="the picture"),
    )
    async def render(request: Request, scene_id: str, body: RenderIn) -> Response:
        """A picture from a free viewpoint, or from one of the scene's own cameras."""
        return await drawn(request, PictureRequest(scene_id, **vars(body)))

    @router.get(
        "/v1/scenes/{scene_id}/mask3d.bin",
        response_class=Response,
        responses={
            **file_response(
                "application/octet-stream",
                description="the mask; G stands in X-Gaussian-Count, the version in X-Scene-Version",
            ),
            **UNCHANGED,
        },
    )
    async def mask3d(
        request: Request,
        scene_id: str,
        text: _Text,
        encoding: Annotated[
            Literal["bits", "runs", "indices"], Query(description=description_of(QueryIn, "mask3d_encoding"))
        ] = "bits",
        version: Version = "",
    ) -> Response:
        """Which Gaussians answer the text."""
        exact, headers = await tagged("mask3d.bin", scene_id, version, text, encoding)
        if (unchanged := not_modified(request, headers)) is not None:
            return unchanged
        question = QueryRequest(
            scene_id, (text,), outputs=frozenset({"mask3d"}), version=exact, mask3d_encoding=encoding
        )
        (answer,) = (await while_connected(request, threads.answer(lambda: service.answers.query(question)))).answers
        return Response(
            answer.mask3d,
            media_type="application/octet-stream",
            headers={**headers, "X-Gaussian-Count": str(answer.gaussians), "X-Scene-Version": answer.version},
        )

    return router
