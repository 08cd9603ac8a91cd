"""Keepalive of gRPC streams: a call without replies is cancelled, as a network that is gone does not say so."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Protocol

from fastsplat_contract.v1 import fastsplat_pb2 as pb


class _Call(Protocol):
    """The part of a streaming gRPC call that is used here."""

    def __iter__(self) -> Iterator[pb.StreamQueryResponse]: ...

    def cancel(self) -> object: ...


class KeepaliveReplies(Iterator[pb.StreamQueryResponse]):
    """Replies of a call with a timeout: where the reader waits too long for one, the call is cancelled.

    Time that the reader spends elsewhere does not count.

    Args:
        call: its replies are read.
        limit_s: says how long the silence may last, each time that it is looked at.
    """

    def __init__(self, call: _Call, limit_s: Callable[[], float]) -> None:
        self._call = call
        self._replies = iter(call)
        self._limit_s = limit_s
        self.timed_out = False
        """Whether the call was cancelled for its silence."""
        self._waiting_since: float | None = None
        self._over = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def __next__(self) -> pb.StreamQueryResponse:
        self._waiting_since = time.monotonic()
        try:
            return next(self._replies)
        finally:
            self._waiting_since = None

    def close(self) -> None:
        """Cancel the call, and watch it no longer."""
        self._over.set()
        self._call.cancel()

    def _watch(self) -> None:
        while not self._over.wait(self._limit_s() / 8):
            since = self._waiting_since
            if since is not None and time.monotonic() - since > self._limit_s():
                self.timed_out = True
                self._call.cancel()
                return
