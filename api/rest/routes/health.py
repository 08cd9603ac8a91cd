"""Health checks over HTTP, which need no thread or key and have no limit."""

from __future__ import annotations

from fastapi import APIRouter

from fastsplat.api.health import Readiness
from fastsplat.api.rest.problem_answers import PROBLEM_RESPONSE


def health_routes(readiness: Readiness) -> APIRouter:
    """Builds the routes of liveness and readiness."""
    router = APIRouter()

    @router.get("/livez")
    async def livez() -> dict[str, str]:
        """The process runs its event loop."""
        return {"status": "ok"}

    @router.get("/readyz", responses={"4XX": PROBLEM_RESPONSE, "5XX": PROBLEM_RESPONSE})
    async def readyz() -> dict[str, str]:
        """The database answers, the data folder can be written, the models are there, and no stop is under way."""
        readiness.require()
        return {"status": "ok"}

    return router
