"""REST routes of plain request and answer, generated from the table of calls."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping
from dataclasses import fields
from functools import partial
from inspect import Parameter, Signature
from types import GenericAlias, NoneType
from typing import Any, get_args, get_type_hints

from fastapi import APIRouter, Query, Request
from pydantic.fields import FieldInfo
from starlette.responses import Response

from fastsplat.api.handlers import HANDLERS, Handler
from fastsplat.api.rest.responses import PROBLEMS, accepted, json_of_call, json_response, while_connected
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.call import Call, Tag
from fastsplat_contract.calls import LOCALIZE, OBSERVE_SCENE
from fastsplat_contract.codec.json_codec import to_json
from fastsplat_contract.codec.members import Member, members
from fastsplat_contract.codec.wire import Request as Body

_FORMS = {LOCALIZE.rpc, OBSERVE_SCENE.rpc}
"""Calls with form requests, whose routes are written by hand."""


def table_routes(tag: Tag, service: SceneService, threads: Threads, root_path: str) -> APIRouter:
    """Builds the routes of a tag's calls; `root_path` prefixes URLs in answers."""
    router = APIRouter(responses=PROBLEMS)
    for rpc, handler in HANDLERS.items():
        call = handler.call
        if call.tag == tag and call.response is not bytes and rpc not in _FORMS:
            method, path = call.route.split(" ")
            kind: dict[str, Any] = {"response_model": call.response}
            if call.response is NoneType:
                kind = {"response_class": Response}
            endpoint = _endpoint(handler, service, threads, root_path)
            router.add_api_route(path, endpoint, methods=[method], status_code=call.status, **kind)
    return router


def _endpoint(
    handler: Handler[Any, Any], service: SceneService, threads: Threads, root_path: str
) -> Callable[..., Awaitable[Response]]:
    """Builds a call's FastAPI endpoint, with the call's name, description and parameters."""
    call = handler.call
    body = _body(call)
    lists = {member.name for member in _members(call) if member.many}

    async def endpoint(request: Request, **parameters: Any) -> Response:
        sent = parameters.pop("body", None)
        named = {name: tuple(value) if name in lists else value for name, value in parameters.items()}
        if body is not None:
            named |= vars(sent if sent is not None else body())
        message = call.request(**named) if call.request is not NoneType else None
        ask = partial(handler.ask, service, message)
        if call.status == 200:
            return await json_of_call(request, partial(handler.run, threads), ask)
        if call.status == 202:
            return accepted(await while_connected(request, handler.run(threads, ask)), root_path)
        result = await handler.run(threads, ask)
        if call.status == 201:
            return json_response(to_json(result), 201, {"Cache-Control": "no-store"})
        return Response(status_code=204)

    endpoint.__name__ = re.sub(r"(?<=.)(?=[A-Z])", "_", call.rpc).lower()
    endpoint.__doc__ = call.about
    return with_parameters(endpoint, _parameters(call, body))


def _members(call: Call[Any, Any]) -> tuple[Member, ...]:
    request: Any = call.request
    return members(request) if request is not NoneType else ()


def _body(call: Call[Any, Any]) -> Any:
    """Finds the body's type: the request, or its base without the path's members."""
    if call.route.startswith(("GET ", "DELETE ")):
        return None
    in_path = set(re.findall(r"{(\w+)}", call.route))
    forms: tuple[Any, ...] = call.request.__mro__
    for kind in forms:
        if issubclass(kind, Body) and kind is not Body and not in_path & {member.name for member in members(kind)}:
            return kind if members(kind) else None
    return None


def _parameters(call: Call[Any, Any], body: Any) -> Iterator[Parameter]:
    in_path = re.findall(r"{(\w+)}", call.route)
    for name in in_path:
        yield _parameter(name, str)
    if body is not None:
        yield _parameter("body", body | None, None) if call.body_optional else _parameter("body", body)
        return
    members_asked = (member.name for member in _members(call) if member.name not in in_path)
    yield from query_parameters(call.request, {name: name for name in members_asked})


def with_parameters(
    endpoint: Callable[..., Awaitable[Response]], parameters: Iterable[Parameter]
) -> Callable[..., Awaitable[Response]]:
    """Sets the endpoint's signature: the request and these parameters."""
    signature = Signature([_parameter("request", Request), *parameters], return_annotation=Response)
    vars(endpoint)["__signature__"] = signature
    return endpoint


def query_parameters(kind: Any, names: Mapping[str, str], **defaults: Any) -> Iterator[Parameter]:
    """Generates query parameters, named by `names`, from members of a request type."""
    field_defaults = {field.name: field.default for field in fields(kind)} if names else {}
    hints = get_type_hints(kind, include_extras=True) if names else {}
    for member in members(kind) if names else ():
        if (name := names.get(member.name)) is None:
            continue
        value: Any = member.kind | None if member.optional else member.kind
        default: Any = field_defaults[member.name] if member.default else defaults.get(name, ...)
        if member.many:
            value, default = GenericAlias(list, member.kind), list(default) if member.default else ...
        marks = get_args(hints[member.name])  # additions to the JSON schema
        extra = next((mark.json_schema_extra for mark in marks if isinstance(mark, FieldInfo)), None)
        yield _parameter(name, value, Query(default, description=member.description, json_schema_extra=extra))


def _parameter(name: str, kind: Any, default: Any = Parameter.empty) -> Parameter:
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)
