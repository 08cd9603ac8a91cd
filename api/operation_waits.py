"""Long polling and watching of operations, for both protocols."""

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
    """One state of an operation.

    Attributes:
        id: names the state, so that a watcher that was cut off can say what it knows.
        operation: the operation in that state.
    """

    id: str
    operation: Operation


class Operations:
    """Watched operations: polled on a thread, so that waiting callers hold none."""

    def __init__(self, service: SceneService, threads: Threads) -> None:
        self._service = service
        self._threads = threads

    async def get(self, operation_id: str) -> Operation:
        """The operation as it stands. Raises `NotFoundError`: there is none of that id."""
        return await self._threads.call(lambda: self._service.get_operation(operation_id))

    async def wait(self, operation_id: str, timeout_s: float) -> Operation:
        """The operation as soon as it is done, or as it stands after `timeout_s` seconds.

        Raises:
            InvalidInputError: `timeout_s` is not 0 to `MAX_WAIT_S`.
            NotFoundError: there is none of that id.
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
        """The operation as it stands, with the name of this state. Raises `NotFoundError`: there is none of that id."""
        operation = await self.get(operation_id)
        return Change(_state_id(operation), operation)

    async def changes(self, first: Change, last_id: str = "") -> AsyncGenerator[Change]:
        """`first`, unless its id is `last_id`, then every change until the operation is done.

        Raises:
            NotFoundError: the operation was deleted meanwhile.
        """
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
    # The seconds of a running stage count by themselves; they are sent with the next change.
    timeless = replace(operation, stages=tuple(replace(stage, seconds=0.0) for stage in operation.stages))
    return hashlib.sha256(to_json(timeless)).hexdigest()[:16]
