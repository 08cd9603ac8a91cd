"""In-process HTTP transport: requests of this process to its own application."""

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
    """Transport from any thread but the loop's own into an application on its event loop.

    Args:
        app: the application.
        loop: that it runs on.
        caller: address and port that the requests come from.
    """

    def __init__(self, app: ASGIApp, loop: asyncio.AbstractEventLoop, caller: tuple[str, int]) -> None:
        self._inner = httpx.ASGITransport(app, raise_app_exceptions=False, client=caller)
        self._loop = loop
        self._lock = threading.Lock()
        self._under_way: set[Future[httpx.Response]] = set()
        self._stopped = False

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        """The whole answer.

        Raises:
            httpx.ReadTimeout: it has not come in the time of the request.
            httpx.ReadError: nobody wants it any more, see `stop`.
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
        """End what is under way, down to the rasterizer, and take no more."""
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
    """The body as it is read from its files: an upload is larger than memory."""
    assert isinstance(request.stream, httpx.SyncByteStream)
    for piece in request.stream:
        yield piece


@contextmanager
def running_loop() -> Iterator[asyncio.AbstractEventLoop]:
    """An event loop on a thread of its own while the block runs."""
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
