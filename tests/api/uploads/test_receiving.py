"""Receiving on the event loop: the bytes are the same, calls of one upload never overlap, `close` is the last one."""

from __future__ import annotations

import asyncio
import random
import threading
from collections.abc import AsyncIterator, Sequence

import pytest

from fastsplat.api.receiving import UploadReceiver
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.settings import LimitSettings, UploadSettings
from fastsplat_contract.errors import CancelledError, InvalidInputError, OverloadedError
from tests.at_once import on_a_loop


class _Sink:
    """Collects bytes, and notes what was called."""

    slow_finish = True

    def __init__(self, refused_after: int | None = None) -> None:
        self.calls: list[str] = []
        self.data = b""
        self._busy = threading.Lock()
        self._refused_after = refused_after

    def open(self) -> _Sink:
        self._note("open")
        return self

    def write(self, items: Sequence[bytes]) -> None:
        assert self._busy.acquire(blocking=False)
        self._note("write")
        self.data += b"".join(items)
        self._busy.release()
        if self._refused_after is not None and len(self.data) > self._refused_after:
            raise InvalidInputError("no more", field="data")

    def finish(self) -> int:
        self._note("finish")
        return len(self.data)

    def close(self) -> None:
        assert self._busy.acquire(blocking=False)
        self._note("close")

    def _note(self, call: str) -> None:
        if self.calls[-1:] != [call]:
            self.calls.append(call)


def _receiver(all_uploads: int = 8) -> UploadReceiver:
    return UploadReceiver(LimitSettings(all_uploads=all_uploads), UploadSettings())


async def _stream(data: bytes, rng: random.Random) -> AsyncIterator[bytes]:
    at = 0
    while at < len(data):
        step = rng.choice([1, 100, 5_000, 70_000])
        yield data[at : at + step]
        at += step
        if rng.random() < 0.3:
            await asyncio.sleep(0)


async def _silent() -> AsyncIterator[bytes]:
    yield b"ab"
    await asyncio.Event().wait()


@on_a_loop
async def test_many_at_once_get_their_own_bytes() -> None:
    receiver = _receiver(100)
    contents = [random.Random(seed).randbytes(seed * 10_000) for seed in range(50)]
    sinks = [_Sink() for _ in contents]
    streams = [_stream(data, random.Random(seed)) for seed, data in enumerate(contents)]
    sizes = await asyncio.gather(
        *(receiver.receive(stream, sink.open, size=len) for stream, sink in zip(streams, sinks, strict=True))
    )
    assert [sink.data for sink in sinks] == contents and sizes == [len(data) for data in contents]
    assert sinks[0].calls == ["open", "finish"]
    assert all(sink.calls == ["open", "write", "finish"] for sink in sinks[1:])
    await asyncio.to_thread(receiver.close)


@on_a_loop
async def test_what_is_refused_is_closed_before_it_is_told_and_its_place_is_free() -> None:
    receiver = _receiver(all_uploads=1)
    for refused_after in (0, 100_000, 299_999):
        sink = _Sink(refused_after)
        with pytest.raises(InvalidInputError):
            await receiver.receive(_stream(bytes(300_000), random.Random(1)), sink.open, size=len)
        assert sink.calls == ["open", "write", "close"]
    await asyncio.to_thread(receiver.close)


@on_a_loop
async def test_uploads_that_the_transport_holds_in_memory_are_bounded_by_their_sum() -> None:
    limits = LimitSettings(all_uploads=8, upload_memory_bytes=2**24)
    receiver = UploadReceiver(limits, UploadSettings())
    sinks = [_Sink(), _Sink()]
    tasks = [
        asyncio.create_task(receiver.receive(_silent(), sink.open, size=len, memory_bytes=2**23)) for sink in sinks
    ]
    while not all(sink.data for sink in sinks):
        await asyncio.sleep(0.01)
    refused = _Sink()
    with pytest.raises(OverloadedError, match="memory"):
        await receiver.receive(_silent(), refused.open, size=len, memory_bytes=1)
    assert not refused.calls
    free = _stream(bytes(1_000), random.Random(1))
    assert await receiver.receive(free, _Sink().open, size=len) == 1_000  # what holds a batch only still comes in
    for task in tasks:
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
    while True:  # the place is free as soon as the upload is closed
        try:
            last = _stream(bytes(1_000), random.Random(1))
            assert await receiver.receive(last, _Sink().open, size=len, memory_bytes=2**24) == 1_000
            break
        except OverloadedError:
            await asyncio.sleep(0.01)
    await asyncio.to_thread(receiver.close)


@on_a_loop
async def test_a_sender_who_pauses_is_written_and_when_he_leaves_it_is_closed() -> None:
    receiver = _receiver(all_uploads=1)
    sink = _Sink()
    task = asyncio.create_task(receiver.receive(_silent(), sink.open, size=len))
    while not sink.data:
        await asyncio.sleep(0.01)
    with pytest.raises(OverloadedError):
        await receiver.receive(_silent(), _Sink().open, size=len)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    await asyncio.to_thread(receiver.close)
    assert sink.calls == ["open", "write", "close"]


@on_a_loop
async def test_a_finish_that_runs_is_cancelled_and_closed_after_it() -> None:
    class Endless(_Sink):
        def finish(self) -> int:
            super().finish()
            begun.set()
            try:
                while True:
                    check_cancelled()
            except CancelledError:
                self._note("cancelled")
                raise

    begun, sink = threading.Event(), Endless()
    receiver = _receiver()
    task = asyncio.create_task(receiver.receive(_stream(b"abc", random.Random(1)), sink.open, size=len))
    assert await asyncio.to_thread(begun.wait, 30)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    await asyncio.to_thread(receiver.close)
    assert sink.calls == ["open", "write", "finish", "cancelled", "close"]
