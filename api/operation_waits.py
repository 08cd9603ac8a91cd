"""Long polling and watching of operations, shared by both protocols."""

from __future__ import annotations

import asyncio
import hashlib
import math
from collections.abc import AsyncGenerator
from dataclasses import dataclass, replace

from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat_contract.codec.json_codec import to_json
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.jobs.operations import Operation

POLL_INTERVAL_S = 0.25
MAX_WAIT_S = 300.0


@dataclass(frozen=True)
class Change:
    """One state of an operation; `id` lets a disconnected watcher resume after it."""

    id: str
    operation: Operation


class Operations:
    """Polls operations on shared threads, so that waiting callers hold none."""

    def __init__(self, service: SceneService, threads: Threads) -> None:
        self._service = service
        self._threads = threads

    async def get(self, operation_id: str) -> Operation:
        """Reads an operation. Raises `NotFoundError` for an unknown id."""
        return await self._threads.call(lambda: self._service.get_operation(operation_id))

    async def wait(self, operation_id: str, timeout_s: float) -> Operation:
        """Waits until an operation is done or `timeout_s` seconds have passed.

        Raises:
            InvalidInputError: `timeout_s` is not 0 to `MAX_WAIT_S`.
            NotFoundError: the id is unknown.
        """
        if not (math.isfinite(timeout_s) and 0 <= timeout_s <= MAX_WAIT_S):
            raise InvalidInputError(f"a wait of {timeout_s} s", field="timeout_s", limit=f"0 to {MAX_WAIT_S:g} s")
        clock = asyncio.get_running_loop().time
        deadline = clock() + timeout_s
        while True:
            operation = await self.get(operation_id)
            remaining = deadline - clock()
            if operation.done or remaining <= 0:
                return operation
            await asyncio.sleep(min(POLL_INTERVAL_S, remaining))

    async def current(self, operation_id: str) -> Change:
        """Reads an operation with its state id. Raises `NotFoundError` for an unknown id."""
        operation = await self.get(operation_id)
        return Change(_state_id(operation), operation)

    async def changes(self, first: Change, last_id: str = "") -> AsyncGenerator[Change]:
        """Yields `first` unless its id is `last_id`, then every change; `NotFoundError` on deletion."""
        change = first
        while True:
            if change.id != last_id:
                last_id = change.id
                yield change
            if change.operation.done:
                return
            await asyncio.sleep(POLL_INTERVAL_S)
            change = await self.current(change.operation.id)


def _state_id(operation: Operation) -> str:
    # The running stage's seconds alone are no change.
    timeless = replace(operation, stages=tuple(replace(stage, seconds=0.0) for stage in operation.stages))
    return hashlib.sha256(to_json(timeless)).hexdigest()[:16]
