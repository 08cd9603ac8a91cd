"""Problem documents (RFC 9457) for all error answers."""

from __future__ import annotations

import json
import math
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import Match

from fastsplat.api.errors import Refusal, refusal_of
from fastsplat_contract.codec.json_codec import invalid_input
from fastsplat_contract.errors import (
    FastSplatError,
    InvalidInputError,
    LimitExceededError,
    MethodNotAllowedError,
    NotFoundError,
)

MEDIA_TYPE = "application/problem+json"


PROBLEM_RESPONSE: dict[str, Any] = {
    "description": "a problem (RFC 9457)",
    "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
}
"""OpenAPI response of all errors."""


class BodyTooLargeError(HTTPException):
    """A too large body; an HTTPException, the only kind that FastAPI's body reader passes on."""

    def __init__(self, limit: int) -> None:
        super().__init__(413)
        self.error = LimitExceededError("the body is too large", field="body", limit=f"{limit} bytes")


def problem_response(request_id: str, error: Exception) -> Response:
    refusal = refusal_of(error, request_id)
    headers = {}
    if refusal.status.http in (429, 503):
        headers["Retry-After"] = str(max(1, math.ceil(refusal.retry_after_s or 1)))
    if refusal.status.http == 401:
        headers["WWW-Authenticate"] = 'Bearer realm="fastsplat"'
    return Response(_document(refusal), refusal.status.http, headers=headers, media_type=MEDIA_TYPE)


def problem_document(request_id: str, error: Exception) -> str:
    """Builds the problem document of an error as JSON without line breaks."""
    return _document(refusal_of(error, request_id))


def _document(refusal: Refusal) -> str:
    members = {name: value for name, value in vars(refusal.as_problem()).items() if value is not None}
    return json.dumps(members, ensure_ascii=False)


def install(app: FastAPI) -> None:
    """Registers handlers that answer known errors with problems; `OuterLayer` answers all others."""
    app.add_exception_handler(FastSplatError, _known)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _transport)


async def _known(request: Request, error: Exception) -> Response:
    return problem_response(request.state.request_id, error)


async def _invalid(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    errors = error.errors()
    where, *inside = errors[0]["loc"]
    if not inside or isinstance(inside[0], int):  # an offset in malformed JSON
        errors = [{**errors[0], "loc": ("", where)}]
    problem = invalid_input(errors, skip=1)
    problem.hint = problem.hint or "The fields, their types and their units are described at /docs."
    return problem_response(request.state.request_id, problem)


async def _transport(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    if isinstance(error, BodyTooLargeError):
        return problem_response(request.state.request_id, error.error)
    path = request.url.path[:200]
    if error.status_code == 405:
        allowed = _allowed(request)
        response = problem_response(
            request.state.request_id, MethodNotAllowedError(f"{request.method} {path} is not possible", limit=allowed)
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
    """Lists the methods of all routes of a path; Starlette reports only the first route's."""
    routes = request.app.router.routes
    methods = ("GET", "HEAD", "POST", "PATCH", "DELETE", "OPTIONS")

    def fits(method: str) -> bool:
        return any(route.matches({**request.scope, "method": method})[0] is Match.FULL for route in routes)

    # `head_as_get` answers HEAD wherever there is GET.
    return ", ".join(method for method in methods if fits(method) or (method == "HEAD" and fits("GET")))
