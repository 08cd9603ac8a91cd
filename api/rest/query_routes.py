"""The REST routes of questions, pictures and files of finished scenes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request
from fastapi import Path as PathParameter
from starlette.responses import Response

from fastsplat.api.rest.responses import PROBLEMS, file_response, json_of_call, while_connected
from fastsplat.api.rest.routes import Version
from fastsplat.api.rest.standard_http import etag_of, not_modified
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.masks import Mask3dEncoding
from fastsplat_contract.members import description_of
from fastsplat_contract.pictures import PictureFormat, PictureKind, PictureRequest, RenderIn
from fastsplat_contract.queries import QueryIn, QueryOut, QueryRequest

_MEDIA_TYPES: dict[PictureFormat, str] = {
    "png": "image/png",
    "npy": "application/octet-stream",
    "jpeg": "image/jpeg",
}
_UNCHANGED: dict[int | str, dict[str, Any]] = {304: {"description": "the copy that If-None-Match names is the same"}}

_Text = Annotated[str, Query(description="the question")]
_View = Annotated[str, Query(description="name of one of the scene's cameras")]


def query_routes(service: SceneService, threads: Threads) -> APIRouter:
    """Questions, pictures and files of finished scenes."""
    router = APIRouter(responses=PROBLEMS)

    async def own_view(request: Request, picture: PictureRequest) -> Response:
        """A picture that never changes for one version: a client's copy is not made anew."""
        version = await threads.call(lambda: service.versions.resolve(picture.scene_id, picture.version))
        exact = replace(picture, version=version)
        headers = {"ETag": etag_of(exact), "Cache-Control": "private, no-cache"}
        if (unchanged := not_modified(request, headers)) is not None:
            return unchanged
        content = await while_connected(
            request, threads.answer(lambda: service.answers.picture(exact), background=True)
        )
        return Response(content, media_type=_MEDIA_TYPES[picture.format], headers=headers)

    async def tagged(name: str, scene_id: str, version: str, *question: str) -> tuple[str, dict[str, str]]:
        """The version that is meant, and the headers of an answer that never changes for it."""
        exact = await threads.call(lambda: service.versions.resolve(scene_id, version))
        return exact, {"ETag": etag_of(name, scene_id, exact, *question), "Cache-Control": "private, no-cache"}

    @router.get("/query", response_model=QueryOut)
    async def query(
        request: Request,
        text: Annotated[list[str], Query(description="the question; several are allowed")],
        scene: Annotated[str, Query(description="scene id; empty: all ready scenes of the project, newest first")] = "",
        version: Version = "",
        outputs: Annotated[
            list[Literal["mask3d", "objects"]], Query(description="what to compute beside the ranking")
        ] = [],
        negatives: Annotated[list[str], Query(description="canonical negatives; none: the server's")] = [],
        templates: Annotated[list[str], Query(description="sentences with one {}; none: the server's")] = [],
        coverage: Annotated[
            float | None,
            Query(
                description=description_of(QueryIn, "coverage"),
                json_schema_extra={"exclusiveMinimum": 0, "exclusiveMaximum": 1},
            ),
        ] = None,
        max_matches: Annotated[
            int, Query(ge=-1, lt=2**31, description="best entries to return; 0: the server's default, -1: all")
        ] = 0,
        mask3d_encoding: Annotated[
            Mask3dEncoding, Query(description=description_of(QueryIn, "mask3d_encoding"))
        ] = "bits",
        asker_view: Annotated[
            str | None, Query(description="name of one of the scene's cameras where you stand")
        ] = None,
    ) -> Response:
        """Ranked labels for a text, in one scene or in all of the project."""
        question = QueryRequest(
            scene,
            tuple(text),
            outputs=frozenset(outputs),
            version=version,
            negatives=tuple(negatives),
            templates=tuple(templates),
            coverage=coverage,
            max_matches=max_matches,
            mask3d_encoding=mask3d_encoding,
            asker_view=asker_view,
        )
        return await json_of_call(request, threads.answer, lambda: service.answers.query(question))

    @router.post("/v1/scenes/{scene_id}:query", response_model=QueryOut)
    async def query_scene(request: Request, scene_id: str, body: QueryIn) -> Response:
        """Ranked labels, 2D masks at poses or views, 3D masks, and objects."""
        question = QueryRequest(scene_id, **vars(body))
        run = partial(threads.answer, background="mask2d" in body.outputs)
        return await json_of_call(request, run, lambda: service.answers.query(question))

    @router.get(
        "/v1/scenes/{scene_id}/{kind}.png",
        response_class=Response,
        responses={**file_response("image/png", description="the picture"), **_UNCHANGED},
    )
    async def view_picture(
        request: Request,
        scene_id: str,
        kind: Annotated[PictureKind, PathParameter(description=description_of(RenderIn, "kind"))],
        view: _View,
        text: Annotated[str | None, Query(description="the question; overlay, relevancy and mask need one")] = None,
        version: Version = "",
        depth_scale: Annotated[float, Query(ge=0, description=description_of(RenderIn, "depth_scale"))] = 0.0,
    ) -> Response:
        """A picture from one of the scene's own cameras."""
        picture = PictureRequest(scene_id, kind, text, view=view, version=version, depth_scale=depth_scale)
        return await own_view(request, picture)

    @router.get(
        "/v1/scenes/{scene_id}/{kind}.npy",
        response_class=Response,
        responses={**file_response(_MEDIA_TYPES["npy"], description="numpy's file format"), **_UNCHANGED},
    )
    async def view_array(
        request: Request,
        scene_id: str,
        kind: Annotated[
            Literal["label_map", "thing_map", "depth", "normals", "confidence"],
            PathParameter(
                description="label_map: uint16 label ids; thing_map: uint16 ids of things; depth: float32 camera z in "
                "scene units, 0 nothing; normals: float32 [H, W, 3], world frame; confidence: float32, 0 to 1"
            ),
        ],
        view: _View,
        version: Version = "",
    ) -> Response:
        """Labels, things, depth, normals or confidence from one of the scene's own cameras, as an array."""
        picture = PictureRequest(scene_id, kind, view=view, version=version, format="npy")
        return await own_view(request, picture)

    @router.post(
        "/v1/scenes/{scene_id}:render",
        response_class=Response,
        responses=file_response(*_MEDIA_TYPES.values(), description="the picture"),
    )
    async def render(request: Request, scene_id: str, body: RenderIn) -> Response:
        """A picture from a free viewpoint, or from one of the scene's own cameras."""
        picture = PictureRequest(scene_id, **vars(body))
        content = await while_connected(
            request, threads.answer(lambda: service.answers.picture(picture), background=True)
        )
        return Response(content, media_type=_MEDIA_TYPES[body.format])

    @router.get(
        "/v1/scenes/{scene_id}/mask3d.bin",
        response_class=Response,
        responses={
            **file_response(
                "application/octet-stream",
                description="the mask; G stands in X-Gaussian-Count, the version in X-Scene-Version",
            ),
            **_UNCHANGED,
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

    @router.get(
        "/v1/scenes/{scene_id}/things.bin",
        response_class=Response,
        responses={
            **file_response(
                "application/octet-stream",
                description="little-endian uint16 ids of things by Gaussian, 0 for none; the version stands in "
                "X-Scene-Version",
            ),
            **_UNCHANGED,
        },
    )
    async def thing_ids(request: Request, scene_id: str, version: Version = "") -> Response:
        """Which thing each Gaussian belongs to."""
        exact, headers = await tagged("things.bin", scene_id, version)
        if (unchanged := not_modified(request, headers)) is not None:
            return unchanged
        ids = await while_connected(request, threads.answer(lambda: service.answers.thing_ids(scene_id, exact)))
        headers["X-Scene-Version"] = exact
        return Response(ids, media_type="application/octet-stream", headers=headers)

    return router
