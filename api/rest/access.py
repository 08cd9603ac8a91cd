"""Access control of HTTP: a middleware that matches the route before the router does."""

from __future__ import annotations

import logging
from typing import Any, cast

from fastapi import FastAPI
from fastapi.routing import APIRoute, RouteContext, iter_route_contexts
from starlette.datastructures import Headers, MutableHeaders
from starlette.routing import Mount
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from fastsplat.api.access.authenticator import Credentials
from fastsplat.api.access.caller import current_principal
from fastsplat.api.access.exposure import check_local
from fastsplat.api.access.gate import Gate
from fastsplat.api.access.policy import UNMATCHED, rule_of
from fastsplat.api.errors import status_of
from fastsplat.api.rest.routes.events import end_events
from fastsplat_contract.calls import DEPRECATED, DEPRECATED_SINCE
from fastsplat_contract.errors import FastSplatError, UnauthenticatedError

_log = logging.getLogger(__name__)

_DEPRECATION = f"@{DEPRECATED_SINCE.timestamp():.0f}"
"""Deprecation header of deprecated calls (RFC 9745)."""
NO_ROUTE = "unmatched"
"""Route name of unmatched requests in metrics."""


class AccessLayer:
    """ASGI middleware that matches a route of `routed`, then passes the gate."""

    def __init__(self, app: ASGIApp, routed: FastAPI, gate: Gate) -> None:
        self._app = app
        self._routed = routed
        self._gate = gate
        self._routes: tuple[_Route, ...] = ()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handles one request. Raises `FastSplatError` on refusal; the outer layer answers."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        route = self.matched_route(scope)
        rule = UNMATCHED if route == NO_ROUTE else rule_of(route)
        started = over = False
        with self._gate.metrics.request(route) as ended:

            async def counted_send(message: Message) -> None:
                nonlocal started, over
                if message["type"] == "http.response.start":
                    if route in DEPRECATED:
                        MutableHeaders(scope=message)["Deprecation"] = _DEPRECATION
                    started = True
                    ended(str(message["status"]))
                over = message["type"] == "http.response.body" and not message.get("more_body")
                await send(message)

            try:
                headers = Headers(scope=scope)
                if not self._gate.auth_enabled and rule.role is not None:
                    with self._gate.refusals_counted():
                        check_local(headers)
                principal = await self._gate.authenticate(Credentials.of(headers), rule)
                current_principal.set(principal)
                if principal is None:
                    await self._app(scope, receive, counted_send)
                    return
                with self._gate.entered(principal, rule):
                    await self._app(scope, receive, counted_send)
            except Exception as error:  # answered by the outer layer
                if started and isinstance(error, UnauthenticatedError):
                    _log.info("%s ends before its answer is complete: %s", route, error.message)
                    if not over:
                        await end_events(scope, send, error)
                    return  # the server closes the connection under any other answer
                ended(str(status_of(error).http if isinstance(error, FastSplatError) else 500))
                raise

    def matched_route(self, scope: Scope) -> str:
        """Finds the route that the router will choose, named as in `RULES`, or `NO_ROUTE`."""
        if not self._routes:
            self._routes = tuple(map(_Route, iter_route_contexts(self._routed.routes)))
        method, path = scope["method"], scope["path"]
        for route in self._routes:
            if route.matches(method, path):
                return route.names.get(method, route.name)
        return NO_ROUTE


def route_name(context: RouteContext, method: str) -> str:
    """Builds a route's name as in `RULES`."""
    if isinstance(context.original_route, Mount):
        return f"MOUNT {context.path}"
    return f"{method} {context.path}"


class _Route:
    """A route reduced to what matching needs, because every request may test all routes."""

    def __init__(self, context: RouteContext) -> None:
        methods = context.methods
        is_api = isinstance(context.original_route, APIRoute) or context.original_route is not context.route
        self._fits = (context if is_api else cast(Any, context.route)).path_regex.match
        self._methods = frozenset(methods) if methods is not None else None
        self.names = {method: route_name(context, method) for method in methods or ()}
        self.name = route_name(context, "")

    def matches(self, method: str, path: str) -> bool:
        """Returns True if the router would choose this route; assumes there is no root path."""
        return (self._methods is None or method in self._methods) and self._fits(path) is not None
