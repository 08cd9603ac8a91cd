"""The REST routes of access keys, for admins of a project and operators."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from fastsplat.api.access.caller import caller_role
from fastsplat.api.rest.responses import PROBLEMS, json_of_call, json_response
from fastsplat.api.rest.routes import PageSize, PageToken
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.json_codec import to_json
from fastsplat_contract.keys import AccessKey, KeyIn, KeyList, LifetimeIn, NewKey, UploadKeyIn


def key_routes(service: SceneService, threads: Threads) -> APIRouter:
    """Keys of the caller's project: make, list, expire, revoke."""
    router = APIRouter(prefix="/v1", responses=PROBLEMS)

    @router.post("/keys", status_code=201, response_model=NewKey)
    async def create_key(body: KeyIn) -> Response:
        """Make a key of the project, of the caller's role at most; its secret is told this once."""
        role = caller_role()
        made = await threads.call(lambda: service.keys.create(role, body))
        return json_response(to_json(made), 201, {"Cache-Control": "no-store"})

    @router.post("/upload-keys", status_code=201, response_model=NewKey)
    async def create_upload_key(body: UploadKeyIn) -> Response:
        """Make a key with which somebody else, e.g. one's phone, may post one scene; its secret is told this once."""
        made = await threads.call(lambda: service.keys.create_for_upload(body))
        return json_response(to_json(made), 201, {"Cache-Control": "no-store"})

    @router.get("/keys", response_model=KeyList)
    async def list_keys(
        request: Request,
        page_size: PageSize = 0,
        page_token: PageToken = "",
        scene_id: Annotated[str, Query(description="only keys that show this scene alone; empty: all")] = "",
    ) -> Response:
        """Keys of the project in pages, newest first, of the caller's role at most; never their secrets."""
        role = caller_role()
        return await json_of_call(
            request, threads.call, lambda: service.keys.list(role, page_size, page_token, scene_id)
        )

    @router.post("/keys/{key_id}:revoke", response_model=AccessKey)
    async def revoke_key(request: Request, key_id: str) -> Response:
        """Take a key back for ever; what it has under way ends within two seconds."""
        role = caller_role()
        return await json_of_call(request, threads.call, lambda: service.keys.revoke(role, key_id))

    @router.post("/keys/{key_id}:expire", response_model=AccessKey)
    async def expire_key(request: Request, key_id: str, body: LifetimeIn) -> Response:
        """Let a valid key expire at another time, sooner or later."""
        role = caller_role()
        return await json_of_call(request, threads.call, lambda: service.keys.expire(role, key_id, body.lifetime_s))

    return router
