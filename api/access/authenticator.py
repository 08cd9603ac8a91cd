"""Authentication of callers by key, at the start of a call and while it runs."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

from fastsplat.api.access.caller import Principal
from fastsplat.service.application.admin.keys import KeyRing, key_id_of
from fastsplat.service.store.rows.records import DEFAULT_PROJECT
from fastsplat_contract.call import Rule
from fastsplat_contract.errors import FastSplatError, NotFoundError, PermissionDeniedError, UnauthenticatedError
from fastsplat_contract.server.keys import Role

_log = logging.getLogger(__name__)

_HOW = 'Send it as "Authorization: Bearer KEY"; make one with: fastsplat keys create'


class Credentials(NamedTuple):
    """A call's access key, and the project it names (operators only); "" where absent."""

    key: str
    project: str = ""

    @classmethod
    def of(cls, headers: Mapping[str, str]) -> Credentials:
        """Reads credentials from HTTP headers or gRPC metadata with lower-case names."""
        scheme, _, value = headers.get("authorization", "").partition(" ")
        key = value if scheme.lower() == "bearer" else headers.get("x-api-key", "")
        return cls(key.strip(), headers.get("x-fastsplat-project", "").strip())


class Authenticator:
    """Authenticates callers against an in-memory copy of the valid keys, at most `FRESH_S` seconds old.

    Not thread-safe: it runs on the event loop only.

    Args:
        load: reads the valid keys from the database, on a thread.
        auth_enabled: if False, no key is needed, and every caller is an operator in the default project.
    """

    FRESH_S = 1.0
    _GLANCE_S = 0.2  # unknown keys may be new: they cause at most one reload in this time

    def __init__(self, load: Callable[[], KeyRing], auth_enabled: bool) -> None:
        self._load = load
        self._auth_enabled = auth_enabled
        self._ring = KeyRing({})
        self._loaded_at = float("-inf")
        self._loading: asyncio.Task[None] | None = None
        self._watches: set[KeyWatch] = set()
        self._watching: asyncio.Task[None] | None = None

    async def authenticate(self, credentials: Credentials, rule: Rule) -> Principal | None:
        """Returns the permitted caller; None for an open route.

        Raises:
            UnauthenticatedError: the key is missing or invalid.
            PermissionDeniedError: the key's role is insufficient, or it is limited to one scene.
            NotFoundError: the project does not exist for this key.
            DatabaseError: the keys cannot be read.
        """
        if rule.role is None:
            return None
        called_at = time.monotonic()
        key_id, project, role, scene_id = await self._key_of(credentials, called_at)
        if credentials.project not in ("", project):
            await self._look_again_unless(lambda: credentials.project in self._ring.projects, called_at)
            if role != "operator" or credentials.project not in self._ring.projects:
                raise NotFoundError(
                    f"no project {credentials.project[:80]!r}",
                    field="x-fastsplat-project",
                    hint="Leave it out for the project of the key.",
                )
        if not rule.allows(role):
            raise PermissionDeniedError(
                f"key {key_id} has the role {role}, and this call needs {rule.role}",
                field="authorization",
                hint=f"Use a key of the role {rule.role}; make one with: fastsplat keys create",
            )
        if scene_id and not rule.shared:
            raise PermissionDeniedError(
                f"key {key_id} shows one scene, and this call is about more, or changes something",
                field="authorization",
                hint="Use a key of the project.",
            )
        return Principal(key_id, credentials.project or project, role, scene_id)

    @contextmanager
    def watch(self, principal: Principal) -> Iterator[KeyWatch]:
        """Ends the running task's block by `UnauthenticatedError` soon after the caller's key becomes invalid."""
        task = asyncio.current_task()
        assert task is not None
        watch = KeyWatch(principal.key_id, task)
        if self._auth_enabled:
            self._watches.add(watch)
            if self._watching is None:
                self._watching = asyncio.create_task(self._look_after_watches())
        try:
            yield watch
        except asyncio.CancelledError:
            if not watch.take_back():  # cancelled by someone else
                raise
        finally:
            self._watches.discard(watch)
        watch.check()

    async def _key_of(self, credentials: Credentials, called_at: float) -> tuple[str, str, Role, str]:
        if not self._auth_enabled:
            return "", DEFAULT_PROJECT, "operator", ""
        if not credentials.key:
            raise UnauthenticatedError("this call carries no key", field="authorization", hint=_HOW)
        key_id = key_id_of(credentials.key)
        while self._loaded_at < called_at - self.FRESH_S:  # a pending reload may have begun too early
            await self._refresh()
        if key_id:
            await self._look_again_unless(lambda: key_id in self._ring, called_at)
        record = self._ring.find(credentials.key)
        if record is None:
            raise UnauthenticatedError("the key is unknown, expired or revoked", field="authorization", hint=_HOW)
        return record.id, record.project, record.role, record.scene_id

    async def _look_again_unless(self, known: Callable[[], bool], called_at: float) -> None:
        """Reloads until `known()`, or until a copy read after the call still lacks it."""
        while not known() and self._loaded_at < called_at:
            await asyncio.sleep(self._GLANCE_S - self._age())
            if self._age() >= self._GLANCE_S:  # no other task has reloaded meanwhile
                await self._refresh()

    async def _look_after_watches(self) -> None:
        while self._watches:
            await asyncio.sleep(max(self._GLANCE_S, self.FRESH_S - self._age()))
            try:
                await self._refresh()
            except FastSplatError as error:  # expiry goes by the clock and needs no reload
                _log.warning("the keys cannot be read again: %s", error.message)
            for watch in tuple(self._watches):
                if not self._ring.is_valid(watch.key_id):
                    watch.end()
        self._watching = None

    def _age(self) -> float:
        return time.monotonic() - self._loaded_at

    async def _refresh(self) -> None:
        if self._loading is None:
            self._loading = asyncio.create_task(self._reload())
            self._loading.add_done_callback(self._loaded)
        await asyncio.shield(self._loading)  # a caller's cancellation must not fail the others

    async def _reload(self) -> None:
        begun = time.monotonic()  # a key revoked during the read may still be in the copy
        self._ring = await asyncio.to_thread(self._load)
        self._loaded_at = begun

    def _loaded(self, task: asyncio.Task[None]) -> None:
        self._loading = None
        if not task.cancelled():
            task.exception()  # the waiting tasks have received it


class KeyWatch:
    """Watch over a call, which is cancelled when its key becomes invalid."""

    def __init__(self, key_id: str, task: asyncio.Task[object]) -> None:
        self.key_id = key_id
        self.ended = False
        self._task = task
        self._deferred = False
        self._cancelled = False

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """Defers cancellation during the block, because gRPC cancelled while writing sends no status."""
        self._deferred = True
        try:
            yield
        finally:
            self._deferred = False
        self.check()

    def end(self) -> None:
        """Cancels the call, or marks it for cancellation, because its key is invalid."""
        if not self.ended:
            self.ended = True
            if not self._deferred:
                self._cancelled = True
                self._task.cancel()

    def take_back(self) -> bool:
        """Undoes the cancellation by `end` and returns True if there was no other."""
        if not self._cancelled:
            return False
        self._cancelled = False
        return self._task.uncancel() == 0

    def check(self) -> None:
        """Raises `UnauthenticatedError` if the key was revoked or has expired."""
        if self.ended:
            self.take_back()
            raise UnauthenticatedError(
                "the key was revoked or has expired during the call", field="authorization", hint=_HOW
            )
