"""A gRPC stream that its client has cut is never taken for one that has ended, however late the news of it come."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Iterator
from typing import Any

import grpc
from grpc import aio

from fastsplat.api.grpc.rpcs import _whole
from fastsplat_contract.errors import CancelledError

_METHOD = "/test/Send"
_MESSAGES = 20


class _WithoutNews:
    """A call's context that has not heard of the call's cancellation yet."""

    def __init__(self, context: Any) -> None:
        self.send_initial_metadata = context.send_initial_metadata

    def done(self) -> bool:
        return False

    def time_remaining(self) -> None:
        return None


def test_a_cut_stream_is_not_a_whole_one() -> None:
    outcomes: list[str] = []

    async def read(messages: AsyncIterator[bytes], context: Any) -> None:
        count = 0
        try:
            async for _ in _whole(messages, _WithoutNews(context)):
                count += 1
        except CancelledError:
            outcomes.append("cut")
        except (asyncio.CancelledError, aio.BaseError):
            outcomes.append("broken")  # before the end was read
        else:
            outcomes.append(f"whole: {count}")

    async def send(messages: AsyncIterator[bytes], context: Any) -> bytes:
        # A task of its own: the news cancel the handler, and this one must do without.
        await asyncio.wait((asyncio.ensure_future(read(messages, context)),))
        return b""

    async def main() -> None:
        server = aio.server()
        handlers = {"Send": grpc.stream_unary_rpc_method_handler(send)}
        server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("test", handlers),))
        port = server.add_insecure_port("127.0.0.1:0")
        await server.start()
        await asyncio.to_thread(_call, port)
        while len(outcomes) < 1 + _MESSAGES:
            await asyncio.sleep(0.01)
        await server.stop(0)

    asyncio.run(asyncio.wait_for(main(), 60))
    assert outcomes[0] == f"whole: {_MESSAGES}"
    assert set(outcomes[1:]) <= {"cut", "broken"} and "cut" in outcomes


def _call(port: int) -> None:
    with grpc.insecure_channel(f"127.0.0.1:{port}") as channel:
        call = channel.stream_unary(_METHOD)
        assert call(iter([b"a"] * _MESSAGES), timeout=60) == b""
        for _ in range(_MESSAGES):
            sent = threading.Event()
            over = threading.Event()

            def messages(sent: threading.Event = sent, over: threading.Event = over) -> Iterator[bytes]:
                yield from [b"a"] * _MESSAGES
                sent.set()
                over.wait(60)

            future = call.future(messages())
            assert sent.wait(60)
            future.cancel()
            over.set()
