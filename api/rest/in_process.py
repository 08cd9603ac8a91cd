"""In-process HTTP transport to this process's own application."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from typing import Any

import httpx
from starlette.types import ASGIApp

_JOIN_S = 30.0


class InProcess(httpx.BaseTransport):
    """Transport to an application on an event loop, usable from any other thread."""

    def __init__(self, app: ASGIApp, loop: asyncio.AbstractEventLoop, caller: tuple[str, int]) -> None:
        self._inner = httpx.ASGITransport(app, raise_app_exceptions=False, client=caller)
        self._loop = loop
        self._lock = threading.Lock()
        self._under_way: set[Future[httpx.Response]] = set()
        self._stopped = False

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        """Sends a request and returns the complete answer.

        Raises:
            httpx.ReadTimeout: the request's read timeout has passed.
            httpx.ReadError: the transport was stopped.
        """
        with self._lock:
            if self._stopped:
                raise httpx.ReadError("nobody waits for the answer any more")
            future = asyncio.run_coroutine_threadsafe(self._answer(request), self._loop)
            self._under_way.add(future)
        try:
            return future.result(request.extensions.get("timeout", {}).get("read"))
        except TimeoutError as error:
            raise httpx.ReadTimeout("no answer in time") from error
        except CancelledError as error:
            raise httpx.ReadError("nobody waits for the answer any more") from error
        finally:
            future.cancel()
            with self._lock:
                self._under_way.discard(future)

    def stop(self) -> None:
        """Cancels running requests, down to the rasterizer, and accepts no more."""
        with self._lock:
            self._stopped = True
            under_way = tuple(self._under_way)
        for future in under_way:
            future.cancel()

    async def _answer(self, request: httpx.Request) -> httpx.Response:
        headers: dict[str, Any] = {**request.headers, "accept-encoding": "identity"}
        has_body = not {"content-length", "transfer-encoding"}.isdisjoint(headers)
        content = _pieces(request) if has_body else None
        inner = httpx.Request(request.method, request.url, headers=headers, content=content)
        response = await self._inner.handle_async_request(inner)
        return httpx.Response(response.status_code, headers=response.headers, content=await response.aread())


async def _pieces(request: httpx.Request) -> AsyncIterator[bytes]:
    """Streams the body, because an upload may exceed memory."""
    assert isinstance(request.stream, httpx.SyncByteStream)
    for piece in request.stream:
        yield piece


@contextmanager
def running_loop() -> Iterator[asyncio.AbstractEventLoop]:
    """Runs an event loop on a separate thread during the block."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, name="event loop", daemon=True)
    thread.start()
    try:
        yield loop
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join(_JOIN_S)
        if not thread.is_alive():
            loop.close()
