"""REST routes of scenes' files: exports and photos."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi import Path as PathParameter
from starlette.responses import Response

from fastsplat.api.rest.files import immutable_file
from fastsplat.api.rest.responses import PROBLEMS, UNCHANGED, file_response, while_connected
from fastsplat.api.rest.routes.scene_routes import Version
from fastsplat.api.rest.standard_http import etag_of, not_modified
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.codec.members import description_of
from fastsplat_contract.messages.exports import FILE_NAMES, FORMATS, ExportFormat, ExportRequest

_Objects = Annotated[list[int], Query(description=description_of(ExportRequest, "object_ids"))]
_Cell = Annotated[float, Query(ge=0, description=description_of(ExportRequest, "cell"))]
_Coarse = Annotated[bool, Query(description=description_of(ExportRequest, "coarse"))]
_MEDIA_TYPES = tuple(dict.fromkeys(facts.media_type for facts in FORMATS.values()))


def export_routes(service: SceneService, threads: Threads) -> APIRouter:
    """Builds the routes of scene exports."""
    router = APIRouter(prefix="/v1", responses=PROBLEMS)

    async def export_file(request: Request, export: ExportRequest) -> Response:
        """Exports a file, or answers 304: a version's file never changes."""
        exact = replace(
            export, version=await threads.call(lambda: service.versions.resolve(export.scene_id, export.version))
        )
        headers = {"ETag": etag_of(exact), "Cache-Control": "private, no-cache"}
        if (unchanged := not_modified(request, headers)) is not None:
            return unchanged
        content = await while_connected(request, threads.answer(lambda: service.exports.file(exact), background=True))
        headers["Content-Disposition"] = f'attachment; filename="{FILE_NAMES[export.format]}"'
        if export.format == "html":  # keeps the page out of this server's origin
            headers["Content-Security-Policy"] = "sandbox"
        return Response(content, media_type=FORMATS[export.format].media_type, headers=headers)

    @router.get(
        "/scenes/{scene_id}/scene.ply",
        response_class=Response,
        responses={
            **file_response(FORMATS["ply"].media_type, description="3DGS PLY"),
            206: {"description": "the range asked for"},
            **UNCHANGED,
        },
    )
    async def scene_ply(request: Request, scene_id: str, version: Version = "", object_ids: _Objects = []) -> Response:
        """The whole scene as a standard 3DGS PLY; Range, If-Range and If-None-Match are understood."""
        if object_ids:
            return await export_file(request, ExportRequest(scene_id, "ply", version, tuple(object_ids)))
        path, current = await while_connected(
            request, threads.answer(lambda: service.answers.scene_ply(scene_id, version))
        )
        return immutable_file(request, path, FORMATS["ply"].media_type, FILE_NAMES["ply"], f"{scene_id}-{current}")

    @router.get(
        "/scenes/{scene_id}/scene.{format}",
        response_class=Response,
        responses={**file_response(*_MEDIA_TYPES, description="the file"), **UNCHANGED},
    )
    async def export_scene(
        request: Request,
        scene_id: str,
        format: Annotated[ExportFormat, PathParameter(description=description_of(ExportRequest, "format"))],
        version: Version = "",
        object_ids: _Objects = [],
        cell: _Cell = 0.0,
        coarse: _Coarse = False,
    ) -> Response:
        """The scene as a file for other programs."""
        return await export_file(request, ExportRequest(scene_id, format, version, tuple(object_ids), cell, coarse))

    return router


_JPEG = "image/jpeg"


def photo_routes(service: SceneService, threads: Threads) -> APIRouter:
    """Builds the route of scenes' photos."""
    router = APIRouter(prefix="/v1", responses=PROBLEMS)

    @router.get(
        "/scenes/{scene_id}/photo.jpg",
        response_class=Response,
        responses={
            **file_response(_JPEG, description="the photo"),
            206: {"description": "the range asked for"},
            **UNCHANGED,
        },
    )
    async def photo(
        request: Request,
        scene_id: str,
        view: Annotated[str, Query(description="name of one of the scene's cameras")],
        version: Version = "",
    ) -> Response:
        """A camera's photo, undistorted: it fits the camera with the intrinsics scaled to its size."""
        path, _ = await while_connected(request, threads.call(lambda: service.photos.path(scene_id, view, version)))
        status = path.stat()  # versions share the file, so its tag survives edits
        tag = etag_of("photo.jpg", scene_id, view, status.st_size, status.st_mtime_ns).strip('"')
        return immutable_file(request, path, _JPEG, "photo.jpg", tag)

    return router
