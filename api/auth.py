"""Who may do what: one table for both faces, decided on the route that was matched, never on the text of a path.

What the table does not name needs a write key, so that nothing is open by mistake.
"""

from __future__ import annotations

import asyncio
import ipaddress
import time
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Literal, NamedTuple

from fastsplat.service.application.keys import KeyRing, key_id_of
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import InvalidInputError, PermissionDeniedError, UnauthenticatedError

Need = Literal["open", "read", "write"]


class Rule(NamedTuple):
    """What a call needs.

    Attributes:
        need: no key, any key, or one that may write.
        standing: it waits or streams for long: it counts among its key's calls, not among those that compute.
        upload: it holds one of the threads that take uploads for as long as its sender likes.
    """

    need: Need
    standing: bool = False
    upload: bool = False


_OPEN = Rule("open")
_READ = Rule("read")
_WRITE = Rule("write")
_WATCH = Rule("read", standing=True)
_UPLOAD = Rule("write", standing=True, upload=True)

UNMATCHED = Rule("read", standing=True)
"""A path that no route has, or not with this method: with any key one learns that there is none."""

_RULES: Mapping[str, Rule] = {
    # The page and the API's description hold nothing of anybody; a browser cannot send a key to ask for them.
    "GET /": _OPEN,
    "GET /docs": _OPEN,
    "GET /openapi.json": _OPEN,
    "HEAD /openapi.json": _OPEN,
    "MOUNT /docs-files": _OPEN,
    "MOUNT /web": _OPEN,
    "GET /livez": _OPEN,
    "GET /readyz": _OPEN,
    "GET /query": _READ,
    "GET /v1/server": _READ,
    "OPTIONS /v1/uploads": _READ,
    "POST /v1/uploads": _UPLOAD,
    "HEAD /v1/uploads/{upload_id}": _WRITE,
    "PATCH /v1/uploads/{upload_id}": _UPLOAD,
    "DELETE /v1/uploads/{upload_id}": _WRITE,
    "GET /v1/scenes": _READ,
    "POST /v1/scenes": _UPLOAD,
    "GET /v1/scenes/{scene_id}": _READ,
    "DELETE /v1/scenes/{scene_id}": _WRITE,
    "POST /v1/scenes/{scene_id}:query": _READ,
    "POST /v1/scenes/{scene_id}:render": _READ,
    "GET /v1/scenes/{scene_id}/{kind}.png": _READ,
    "GET /v1/scenes/{scene_id}/scene.ply": _WATCH,
    "GET /v1/scenes/{scene_id}/mask.ply": _READ,
    "GET /v1/scenes/{scene_id}/mask3d.bin": _READ,
    "GET /v1/scenes/{scene_id}/{kind}.npy": _READ,
    "GET /v1/scenes/{scene_id}/labels": _READ,
    "GET /v1/scenes/{scene_id}/objects": _READ,
    "GET /v1/scenes/{scene_id}/cameras": _READ,
    "GET /v1/scenes/{scene_id}/versions": _READ,
    "POST /v1/scenes/{scene_id}:edit": _WRITE,
    "POST /v1/scenes/{scene_id}:undo": _WRITE,
    "GET /v1/operations": _READ,
    "GET /v1/operations/{operation_id}": _READ,
    "GET /v1/operations/{operation_id}/events": _WATCH,
    "GET /v1/operations/{operation_id}:wait": _WATCH,
    "POST /v1/operations/{operation_id}:cancel": _WRITE,
    "/grpc.health.v1.Health/Check": _OPEN,
    "/grpc.health.v1.Health/List": _OPEN,
    "/grpc.health.v1.Health/Watch": _OPEN,
    "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo": _WATCH,
    "/fastsplat.v1.SceneService/CreateScene": _UPLOAD,
    "/fastsplat.v1.SceneService/GetScene": _READ,
    "/fastsplat.v1.SceneService/ListScenes": _READ,
    "/fastsplat.v1.SceneService/DeleteScene": _WRITE,
    "/fastsplat.v1.SceneService/ListLabels": _READ,
    "/fastsplat.v1.SceneService/ListObjects": _READ,
    "/fastsplat.v1.SceneService/ListVersions": _READ,
    "/fastsplat.v1.SceneService/EditScene": _WRITE,
    "/fastsplat.v1.SceneService/UndoEdit": _WRITE,
    "/fastsplat.v1.SceneService/ListOperations": _READ,
    "/fastsplat.v1.SceneService/GetOperation": _READ,
    "/fastsplat.v1.SceneService/WaitOperation": _WATCH,
    "/fastsplat.v1.SceneService/CancelOperation": _WRITE,
    "/fastsplat.v1.SceneService/WatchOperation": _WATCH,
    "/fastsplat.v1.SceneService/Query": _READ,
    "/fastsplat.v1.SceneService/StreamQuery": _WATCH,
    "/fastsplat.v1.SceneService/DownloadCameras": _READ,
    "/fastsplat.v1.SceneService/RenderView": _READ,
    "/fastsplat.v1.SceneService/DownloadScenePly": _WATCH,
    "/fastsplat.v1.SceneService/DownloadMaskPly": _READ,
}


def rule_of(route: str) -> Rule:
    """The rule of "METHOD /path/{template}", "MOUNT /path" or "/package.Service/Method"."""
    return _RULES.get(route, _WRITE)


def decided(route: str) -> bool:
    """Whether the table names this route."""
    return route in _RULES


@dataclass(frozen=True)
class Principal:
    """Who calls: a key's id, "" where keys are switched off."""

    key_id: str
    can_write: bool


current_principal: ContextVar[Principal | None] = ContextVar("current_principal", default=None)
"""Who makes the call that the running task serves."""


def caller_id() -> str:
    """The id of the key behind the call that the running task serves; "" without keys."""
    principal = current_principal.get()
    return principal.key_id if principal is not None else ""


class Doorkeeper:
    """Knows the keys by heart, and learns them anew often enough: a revoked key opens nothing after `FRESH_S`.

    Args:
        load: reads the valid keys from the database, on a thread; None: keys are switched off.
    """

    FRESH_S = 2.0
    _GLANCE_S = 0.2  # for a key that is not known yet: it may be new, and who guesses costs one look in this time

    def __init__(self, load: Callable[[], KeyRing] | None) -> None:
        self._load = load
        self._ring = KeyRing({})
        self._loaded_at = float("-inf")
        self._loading: asyncio.Task[None] | None = None

    async def admit(self, key: str, rule: Rule) -> Principal | None:
        """Who calls, if they may; None for an open route, whatever key came with it.

        Args:
            key: as the caller sent it; "" for none.
            rule: that of the matched route.

        Raises:
            UnauthenticatedError: no key, or none that is valid.
            PermissionDeniedError: a key that reads, where one that writes is needed.
            DatabaseError: the keys cannot be read.
        """
        if rule.need == "open":
            return None
        if self._load is None:
            return Principal("", True)
        if not key:
            raise UnauthenticatedError("this call carries no key", field="authorization", hint=_HOW)
        known = key_id_of(key)
        if self._age() > self.FRESH_S or (known and known not in self._ring and self._age() > self._GLANCE_S):
            await self._refresh()
        record = self._ring.find(key)
        if record is None:
            raise UnauthenticatedError("the key is unknown, expired or revoked", field="authorization", hint=_HOW)
        if rule.need == "write" and record.kind != "write":
            raise PermissionDeniedError(
                f"key {record.id} may only read", field="authorization", hint="Use a key of the kind write."
            )
        return Principal(record.id, record.kind == "write")

    def _age(self) -> float:
        return time.monotonic() - self._loaded_at

    async def _refresh(self) -> None:
        if self._loading is None:
            self._loading = asyncio.create_task(self._reload())
            self._loading.add_done_callback(self._loaded)
        await asyncio.shield(self._loading)  # a caller that goes away must not fail the others

    async def _reload(self) -> None:
        assert self._load is not None
        begun = time.monotonic()  # a key revoked while this reads may still be in what it brings
        self._ring = await asyncio.to_thread(self._load)
        self._loaded_at = begun

    def _loaded(self, task: asyncio.Task[None]) -> None:
        self._loading = None
        if not task.cancelled():
            task.exception()  # those who wait have seen it


_HOW = 'Send it as "Authorization: Bearer KEY"; make one with: fastsplat keys create'


def sent_key(authorization: str, x_api_key: str) -> str:
    """The key in either header, "" for none."""
    scheme, _, value = authorization.partition(" ")
    return value.strip() if scheme.lower() == "bearer" else x_api_key.strip()


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address of this name."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def check_exposure(settings: Settings) -> None:
    """Keys may be off only where nobody else can come in.

    Raises:
        InvalidInputError: `auth` is off, and `host` is not this machine's own.
    """
    if settings.auth == "off" and not is_loopback(settings.host):
        raise InvalidInputError(
            f"without keys the server does not listen on {settings.host}",
            field="auth",
            limit="loopback (FASTSPLAT_HOST=127.0.0.1)",
            hint="Leave FASTSPLAT_AUTH on, or bind to loopback.",
        )
