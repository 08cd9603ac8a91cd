"""Who may come in over HTTP: every request passes here, with the route it will reach already known."""

from __future__ import annotations

from typing import Any, cast

from fastapi import FastAPI
from fastapi.routing import APIRoute, RouteContext, iter_route_contexts
from starlette.datastructures import Headers
from starlette.routing import Mount
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from fastsplat.api.auth import UNMATCHED, Principal, Rule, current_principal, is_loopback, rule_of, sent_key
from fastsplat.api.doors import Doors
from fastsplat.api.errors import status_of
from fastsplat_contract.errors import FastSplatError, PermissionDeniedError

NO_ROUTE = "unmatched"
"""The name of all that no route has, in metrics."""


class AccessLayer:
    """ASGI middleware: matches as the router will, then asks the doorkeeper and the limiter.

    Args:
        app: the next layer.
        routed: the application whose routes decide.
        doors: see there.
    """

    def __init__(self, app: ASGIApp, routed: FastAPI, doors: Doors) -> None:
        self._app = app
        self._routed = routed
        self._doors = doors
        self._routes: tuple[_Route, ...] = ()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request.

        Raises:
            FastSplatError: it may not come in; the layer outside answers.
        """
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        route = self.matched_route(scope)
        rule = UNMATCHED if route == NO_ROUTE else rule_of(route)
        with self._doors.metrics.request(route) as ended:

            async def counted_send(message: Message) -> None:
                if message["type"] == "http.response.start":
                    ended(str(message["status"]))
                await send(message)

            try:
                principal = await self._admitted(Headers(scope=scope), rule)
                current_principal.set(principal)
                if principal is None:
                    await self._app(scope, receive, counted_send)
                    return
                entry = self._doors.enter(principal, rule)
                try:
                    await self._app(scope, receive, counted_send)
                finally:
                    entry.leave()
            except Exception as error:  # answered by the layer outside
                ended(str(status_of(error).http if isinstance(error, FastSplatError) else 500))
                raise

    def matched_route(self, scope: Scope) -> str:
        """The route that the router will choose, as the table of rules names it; `NO_ROUTE` if it has none."""
        if not self._routes:
            self._routes = tuple(map(_Route, iter_route_contexts(self._routed.routes)))
        method, path = scope["method"], scope["path"]
        for route in self._routes:
            if route.matches(method, path):
                return route.names.get(method, route.name)
        return NO_ROUTE

    async def _admitted(self, headers: Headers, rule: Rule) -> Principal | None:
        doors = self._doors
        if not doors.keys_are_on and rule.need != "open":
            with doors.refusals_counted():
                _check_local(headers)
        key = sent_key(headers.get("authorization", ""), headers.get("x-api-key", ""))
        return await doors.admit(key, rule)


def route_name(context: RouteContext, method: str) -> str:
    """How the table of rules names a route."""
    if isinstance(context.original_route, Mount):
        return f"MOUNT {context.path}"
    return f"{method} {context.path}"


class _Route:
    """One route of the router, with what its own `matches` looks at, and no more: every request passes all of them."""

    def __init__(self, context: RouteContext) -> None:
        methods = context.methods
        self._fits = (context if _own(context) else cast(Any, context.route)).path_regex.match
        self._methods = frozenset(methods) if methods is not None else None
        self.names = {method: route_name(context, method) for method in methods or ()}
        self.name = route_name(context, "")

    def matches(self, method: str, path: str) -> bool:
        """Whether the router would take this route: there is no root path, so the scope's path is the route's."""
        return (self._methods is None or method in self._methods) and self._fits(path) is not None


def _own(context: RouteContext) -> bool:
    return isinstance(context.original_route, APIRoute) or context.original_route is not context.route


def _check_local(headers: Headers) -> None:
    """Without keys, a page of another site that a browser on this machine shows must not reach in.

    Its requests carry its own name as `Origin`, or, by DNS rebinding, as `Host`.
    """
    for name in ("host", "origin"):
        value = headers.get(name, "")
        host = value.rpartition("://")[2]
        host = host[: host.rfind("]") + 1] if host.startswith("[") else host.partition(":")[0]
        if value and not is_loopback(host):
            raise PermissionDeniedError(
                f"without keys, requests for or from {host[:80]!r} are refused",
                field=name,
                hint="Ask http://localhost, or switch the keys on.",
            )
