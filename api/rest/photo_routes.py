"""The REST routes of the photos of scenes, and of the cameras that show a thing best."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from fastsplat.api.rest.files import immutable_file
from fastsplat.api.rest.responses import PROBLEMS, file_response, json_of_call, run_cancellable
from fastsplat.api.rest.routes import PageSize, PageToken, Version
from fastsplat.api.rest.standard_http import etag_of
from fastsplat.api.threads import Threads
from fastsplat.service.application.answering.photos import MAX_VIEWS
from fastsplat.service.application.service import SceneService
from fastsplat_contract.next_photo_messages import NextPhotoList
from fastsplat_contract.photo_messages import BestViewList, PhotoList

_JPEG = "image/jpeg"
_VIEW_BOUNDS: dict[str, Any] = {"minimum": 0, "maximum": MAX_VIEWS}


def photo_routes(service: SceneService, threads: Threads) -> APIRouter:
    """Photos of finished scenes."""
    router = APIRouter(prefix="/v1", responses=PROBLEMS)

    @router.get("/scenes/{scene_id}/photos", response_model=PhotoList)
    async def list_photos(
        request: Request, scene_id: str, version: Version = "", page_size: PageSize = 0, page_token: PageToken = ""
    ) -> Response:
        """The photos that are stored with a scene, in pages, in the order of its cameras."""
        return await json_of_call(
            request, threads.call, lambda: service.photos.all(scene_id, version, page_size, page_token)
        )

    @router.get(
        "/scenes/{scene_id}/photo.jpg",
        response_class=Response,
        responses={
            **file_response(_JPEG, description="the photo"),
            206: {"description": "the range asked for"},
            304: {"description": "the copy that If-None-Match names is the same"},
        },
    )
    async def photo(
        request: Request,
        scene_id: str,
        view: Annotated[str, Query(description="name of one of the scene's cameras")],
        version: Version = "",
    ) -> Response:
        """A camera's photo, undistorted: it fits the camera with the intrinsics scaled to its size."""
        path, _ = await run_cancellable(request, threads.call, lambda: service.photos.path(scene_id, view, version))
        status = path.stat()  # versions share the file: the tag is the file's, so that an edit costs no new download
        tag = etag_of("photo.jpg", scene_id, view, status.st_size, status.st_mtime_ns).strip('"')
        return immutable_file(request, path, _JPEG, "photo.jpg", tag)

    @router.get("/scenes/{scene_id}/next-photos", response_model=NextPhotoList)
    async def list_next_photos(request: Request, scene_id: str, version: Version = "") -> Response:
        """Where to stand for the next photos of a scene: at most three places, the most useful first."""
        return await json_of_call(request, threads.answer, lambda: service.photos.next_photos(scene_id, version))

    @router.get("/scenes/{scene_id}/views", response_model=BestViewList)
    async def list_best_views(
        request: Request,
        scene_id: str,
        things: Annotated[list[int], Query(description="ids of things or parts, seen together")] = [],
        text: Annotated[str, Query(description="instead of things: those that answer it")] = "",
        max_views: Annotated[int, Query(description="at most so many; 0: three", json_schema_extra=_VIEW_BOUNDS)] = 0,
        version: Version = "",
    ) -> Response:
        """Which of the scene's cameras show some things, or the answer to a text, best; and where in their pictures."""
        return await json_of_call(
            request,
            threads.answer,
            lambda: service.photos.best_views(scene_id, things, text, max_views, version),
        )

    return router
