"""Authentication: keys to callers, at the start of a call and for as long as it goes on."""

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
    """Credentials of a call: its key and its project, each "" where it names none.

    Attributes:
        key: the access key.
        project: the project that the call is about, if it is not the key's; for operators.
    """

    key: str
    project: str = ""

    @classmethod
    def of(cls, headers: Mapping[str, str]) -> Credentials:
        """Those in a request's headers, or in a call's metadata; their names are in lower case."""
        scheme, _, value = headers.get("authorization", "").partition(" ")
        key = value if scheme.lower() == "bearer" else headers.get("x-api-key", "")
        return cls(key.strip(), headers.get("x-fastsplat-project", "").strip())


class Authenticator:
    """Turns keys into callers, from a copy of the valid keys in memory that is never older than `FRESH_S` seconds.

    All of it runs on the event loop alone.

    Args:
        load: reads the valid keys from the database, on a thread.
        auth_enabled: False: nobody needs a key, and everybody is an operator in the default project.
    """

    FRESH_S = 1.0
    _GLANCE_S = 0.2  # a key that is not known may be new; whoever guesses waits, and costs one look in this time

    def __init__(self, load: Callable[[], KeyRing], auth_enabled: bool) -> None:
        self._load = load
        self._auth_enabled = auth_enabled
        self._ring = KeyRing({})
        self._loaded_at = float("-inf")
        self._loading: asyncio.Task[None] | None = None
        self._watches: set[KeyWatch] = set()
        self._watching: asyncio.Task[None] | None = None

    async def authenticate(self, credentials: Credentials, rule: Rule) -> Principal | None:
        """Who calls, if they may; None for an open route, whatever key came with it.

        Args:
            credentials: as the caller sent them.
            rule: that of the matched route.

        Raises:
            UnauthenticatedError: no key, or none that is valid.
            PermissionDeniedError: the key's role is too small for this call, or it is a key of one scene.
            NotFoundError: the call is about a project that is not there for this key.
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
        """End the block, which the running task is in, soon after the caller's key is no longer valid.

        Raises:
            UnauthenticatedError: the key was revoked, or has expired, before the block was over.
        """
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
            if not watch.take_back():  # somebody else cancelled it
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
        while self._loaded_at < called_at - self.FRESH_S:  # a reading under way may have begun long ago
            await self._refresh()
        if key_id:
            await self._look_again_unless(lambda: key_id in self._ring, called_at)
        record = self._ring.find(credentials.key)
        if record is None:
            raise UnauthenticatedError("the key is unknown, expired or revoked", field="authorization", hint=_HOW)
        return record.id, record.project, record.role, record.scene_id

    async def _look_again_unless(self, known: Callable[[], bool], called_at: float) -> None:
        """Read until it is known, or not in what was read since the call; an older copy may lack what is new."""
        while not known() and self._loaded_at < called_at:
            await asyncio.sleep(self._GLANCE_S - self._age())
            if self._age() >= self._GLANCE_S:  # nobody else has looked meanwhile
                await self._refresh()

    async def _look_after_watches(self) -> None:
        while self._watches:
            await asyncio.sleep(max(self._GLANCE_S, self.FRESH_S - self._age()))
            try:
                await self._refresh()
            except FastSplatError as error:  # a key that expires meanwhile does so by the clock all the same
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
        await asyncio.shield(self._loading)  # a caller that goes away must not fail the others

    async def _reload(self) -> None:
        begun = time.monotonic()  # a key revoked while this reads may still be in what it brings
        self._ring = await asyncio.to_thread(self._load)
        self._loaded_at = begun

    def _loaded(self, task: asyncio.Task[None]) -> None:
        self._loading = None
        if not task.cancelled():
            task.exception()  # those who wait have seen it


class KeyWatch:
    """A call that is cancelled when its key ends."""

    def __init__(self, key_id: str, task: asyncio.Task[object]) -> None:
        self.key_id = key_id
        self.ended = False
        self._task = task
        self._deferred = False
        self._cancelled = False

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """Where the task must not be cancelled because it runs somebody else's code; the block ends at its end.

        gRPC, cancelled while it sends a message, tells the client nothing; so a client that does not read what it was
        sent hears of the end when it reads on.
        """
        self._deferred = True
        try:
            yield
        finally:
            self._deferred = False
        self.check()

    def end(self) -> None:
        """The key is no longer valid."""
        if not self.ended:
            self.ended = True
            if not self._deferred:
                self._cancelled = True
                self._task.cancel()

    def take_back(self) -> bool:
        """Undo the cancellation by `end`. Returns whether it was the only one."""
        if not self._cancelled:
            return False
        self._cancelled = False
        return self._task.uncancel() == 0

    def check(self) -> None:
        """Raise once the key is no longer valid. Raises `UnauthenticatedError`: it was revoked, or has expired."""
        if self.ended:
            self.take_back()
            raise UnauthenticatedError(
                "the key was revoked or has expired during the call", field="authorization", hint=_HOW
            )
