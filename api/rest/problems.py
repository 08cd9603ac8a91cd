"""Every answer that is not a success is a problem (RFC 9457)."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import Match

from fastsplat.api.errors import problem_of
from fastsplat.service.common.errors import FastSplatError, InvalidInputError, Kind, LimitExceededError, NotFoundError

MEDIA_TYPE = "application/problem+json"


PROBLEM_RESPONSE: dict[str, Any] = {
    "description": "a problem (RFC 9457)",
    "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
}
"""What OpenAPI says of every answer that is not a success."""


class Problem(BaseModel):
    """An RFC 9457 problem."""

    type: str = Field(description="a URN, one per reason")
    title: str = Field(description="the same for every problem of this status")
    status: int = Field(description="the HTTP status code")
    detail: str = Field(description="what is wrong, in one sentence")
    reason: str = Field(description="UPPER_SNAKE_CASE name, stable across releases and the same over gRPC")
    field: str | None = Field(None, description="the input to blame")
    limit: str | None = Field(None, description="the bound that was crossed, with its unit")
    hint: str | None = Field(None, description="what to do about it")
    request_id: str = Field(description="that of the X-Request-Id header; finds the request in the server's log")


class BodyTooLargeError(HTTPException):
    """An HTTPException, as FastAPI lets only those pass while it reads a body."""

    def __init__(self, limit: int) -> None:
        super().__init__(413)
        self.error = LimitExceededError("the body is too large", field="body", limit=f"{limit} bytes")


class _MethodNotAllowedError(FastSplatError):
    kind = Kind.INVALID_ARGUMENT
    reason = "METHOD_NOT_ALLOWED"


def problem_response(request_id: str, error: Exception) -> Response:
    """The response that tells of `error`."""
    problem = problem_of(error, request_id)
    headers = {}
    if problem.status.http in (429, 503):
        headers["Retry-After"] = str(max(1, math.ceil(problem.retry_after_s or 1)))
    if problem.status.http == 401:
        headers["WWW-Authenticate"] = 'Bearer realm="fastsplat"'
    body = json.dumps(problem.as_json(), ensure_ascii=False)
    return Response(body, problem.status.http, headers=headers, media_type=MEDIA_TYPE)


def install(app: FastAPI) -> None:
    """Make `app` answer every error it knows of with a problem; the middleware does so for all others."""
    app.add_exception_handler(FastSplatError, _known)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _transport)


async def _known(request: Request, error: Exception) -> Response:
    return problem_response(request.state.request_id, error)


async def _invalid(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    problem = InvalidInputError(
        first["msg"],
        field=_field(first["loc"]),
        hint="The fields, their types and their units are described at /docs.",
    )
    return problem_response(request.state.request_id, problem)


async def _transport(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    if isinstance(error, BodyTooLargeError):
        return problem_response(request.state.request_id, error.error)
    path = request.url.path[:200]
    if error.status_code == 405:
        allowed = _allowed(request)
        response = problem_response(
            request.state.request_id, _MethodNotAllowedError(f"{request.method} {path} is not possible", limit=allowed)
        )
        response.headers["Allow"] = allowed
        return response
    if error.status_code == 404:
        return problem_response(
            request.state.request_id,
            NotFoundError(f"there is no {path}", field="path", hint="The routes are described at /docs."),
        )
    return problem_response(request.state.request_id, InvalidInputError(str(error.detail)))


def _allowed(request: Request) -> str:
    """Starlette names the methods of the first route that fits; a path may have several routes."""
    routes = request.app.router.routes
    methods = ("GET", "POST", "DELETE")
    fitting = (m for m in methods if any(r.matches({**request.scope, "method": m})[0] is Match.FULL for r in routes))
    return ", ".join(fitting)


def _field(location: Sequence[Any]) -> str:
    """("body", "cameras", 0, "position") to cameras[0].position; a place in unreadable JSON is just the body."""
    inside = location[1:]
    if not inside or isinstance(inside[0], int):
        return str(location[0])
    name = ""
    for part in inside:
        name += f"[{part}]" if isinstance(part, int) else f".{part}" if name else str(part)
    return name
