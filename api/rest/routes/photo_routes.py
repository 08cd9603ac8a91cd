"""REST route of scenes' photos."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from fastsplat.api.rest.files import immutable_file
from fastsplat.api.rest.responses import PROBLEMS, UNCHANGED, file_response, while_connected
from fastsplat.api.rest.routes.scene_routes import Version
from fastsplat.api.rest.standard_http import etag_of
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService

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
