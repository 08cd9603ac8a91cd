"""Claims to jobs, and updates that only the newest one makes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from sqlalchemy import Connection, Update, update

from fastsplat.service.store.records import OperationRecord
from fastsplat.service.store.schema import operations

JobRequest = Literal["cancel", "finish"]
"""What was asked of a job that runs: to stop, or to end its training early and to keep what is there."""


class FencedError(Exception):
    """The claim is not the newest of its job any more, or the job is over; stop, and touch nothing of it."""


@dataclass(frozen=True)
class Claim:
    """The right to run a job until another worker claims it; `attempt` is the fencing token, and counts up."""

    operation: OperationRecord
    attempt: int


def fenced(claim: Claim) -> Update:
    """An update of the operation, if the claim is its newest and it is not over."""
    return update(operations).where(
        operations.c.id == claim.operation.id,
        operations.c.attempt == claim.attempt,
        operations.c.state == "RUNNING",
    )


def uncancelled(claim: Claim) -> Update:
    """The same, if it is not to be cancelled."""
    return fenced(claim).where(operations.c.cancel_requested.is_(False))


def execute_fenced(connection: Connection, claim: Claim, statement: Update) -> None:
    """Execute an update.

    Raises:
        FencedError: it changes nothing.
    """
    if not connection.execute(statement).rowcount:
        raise FencedError(claim.operation.id)
