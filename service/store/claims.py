"""Claims to jobs: which worker has which, and updates that only the newest claim makes."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from typing import Literal

from sqlalchemy import Connection, Engine, Update, func, select, update

from fastsplat.service.store.damaged_rows import each_readable
from fastsplat.service.store.database import transaction
from fastsplat.service.store.records import AGAIN_AFTER, RELEASED, OperationRecord
from fastsplat.service.store.scene_repository import as_operation
from fastsplat.service.store.schema import operations
from fastsplat_contract.operations import AgainAfter

_UNCLAIMED = (operations.c.state == "QUEUED") | ((operations.c.state == "RUNNING") & (operations.c.worker == ""))

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
        operations.c.id == claim.operation.id, operations.c.attempt == claim.attempt, operations.c.state == "RUNNING"
    )


def uncancelled(claim: Claim) -> Update:
    """The same, if it is not to be cancelled."""
    return fenced(claim).where(operations.c.cancel_requested.is_(False))


def execute_fenced(connection: Connection, claim: Claim, statement: Update) -> None:
    """Execute an update. Raises `FencedError`: it changes nothing."""
    if not connection.execute(statement).rowcount:
        raise FencedError(claim.operation.id)


class JobQueue:
    """The queue; every method is one or two transactions, and raises `DatabaseError` when the database is away."""

    def __init__(self, engine: Engine) -> None:
        self._writing = partial(transaction, engine)
        self._reading = partial(transaction, engine.execution_options(read_only=True))

    def waiting(self) -> Sequence[OperationRecord]:
        """Operations that no worker has: those whose worker died or gave them back, then queued ones; by priority and
        age."""
        query = select(operations).where(_UNCLAIMED)
        order = (operations.c.state.desc(), operations.c.priority.desc(), operations.c.created_at, operations.c.id)
        with self._reading() as connection:
            return each_readable(connection.execute(query.order_by(*order)).mappings(), as_operation)

    def claim_next(self, worker: str) -> Claim | None:
        """Start an attempt of the first job `in_turn`. None if nothing waits, or another worker was faster."""
        waiting = self.in_turn()
        return self.claim(waiting[0].id, worker) if waiting else None

    def in_turn(self) -> Sequence[OperationRecord]:
        """Operations that no worker has, as they would begin if all that are under way ended now.

        Those that were begun go first. Then projects take turns: first the one with the fewest jobs under way; of
        several, the one whose latest job is longest ago, then the one that has waited longest. Within a project
        priority decides, then age.
        """
        waiting = self.waiting()
        mine: dict[str, list[OperationRecord]] = {}
        for job in waiting:
            if job.state == "QUEUED":
                mine.setdefault(job.project, []).append(job)
        if len(mine) < 2:  # as mostly, when a worker asks
            return waiting
        begun = [job for job in waiting if job.state == "RUNNING"]
        project = operations.c.project
        running = select(project, func.count()).where(operations.c.state == "RUNNING").group_by(project)
        latest = select(project, func.max(operations.c.updated_at)).where(operations.c.attempt > 0).group_by(project)
        with self._reading() as connection:
            active: dict[str, int] = dict(connection.execute(running).all())
            last: dict[str, float] = dict(connection.execute(latest).all())
        oldest = {name: min(job.created_at for job in jobs) for name, jobs in mine.items()}
        turns = sorted(mine, key=lambda name: (active.get(name, 0), last.get(name, 0.0), oldest[name]))
        rounds = zip_longest(*(mine[name] for name in turns))
        return [*begun, *(job for each in rounds for job in each if job is not None)]

    def under_way(self) -> Sequence[OperationRecord]:
        """Operations that a worker has."""
        query = select(operations).where(operations.c.state == "RUNNING", operations.c.worker != "")
        with self._reading() as connection:
            return each_readable(connection.execute(query).mappings(), as_operation)

    def claim(self, operation_id: str, worker: str = "") -> Claim | None:
        """Start an attempt of a job that waits: counts one start and fences earlier claims. Until `worker`, by its
        executor id ("": nobody), ends, or `take_back`, nobody else may claim it.

        Returns:
            None if the operation does not wait: another worker has it, or it is over or deleted.
        """
        waiting = select(operations).where(operations.c.id == operation_id, _UNCLAIMED).with_for_update()
        with self._writing() as connection:
            row = connection.execute(waiting).mappings().first()
            if row is None:
                return None
            before = as_operation(row)
            return _begin(connection, before, "worker_stopped" if RELEASED in before.options else "worker_died", worker)

    def claim_again(self, claim: Claim) -> Claim:
        """Start another attempt of a worker whose trainer died. Raises `FencedError`: as `report`."""
        with self._writing() as connection:
            execute_fenced(connection, claim, fenced(claim).values(updated_at=time.time()))
            row = connection.execute(select(operations).where(operations.c.id == claim.operation.id)).mappings().one()
            return _begin(connection, as_operation(row), "trainer_died", row["worker"])

    def owners(self) -> Mapping[str, float]:
        """The workers that have unfinished jobs, and when one was last written to, in seconds since 1970."""
        owned = operations.c.state == "RUNNING", operations.c.worker != ""
        latest = select(operations.c.worker, func.max(operations.c.updated_at)).where(*owned)
        with self._reading() as connection:
            return dict(connection.execute(latest.group_by(operations.c.worker)).all())

    def take_back(self, worker: str) -> None:
        """Let others claim the unfinished jobs of a worker that is dead."""
        with self._writing() as connection:
            connection.execute(update(operations).where(operations.c.worker == worker).values(worker=""))


def _begin(connection: Connection, before: OperationRecord, after: AgainAfter, worker: str) -> Claim:
    """Begin an attempt of an unfinished operation; `after` is what ended the one before, if that was under way."""
    options = {name: value for name, value in before.options.items() if name != RELEASED}
    if before.state == "RUNNING":
        options[AGAIN_AFTER] = after
    here = operations.c.id == before.id
    values = {
        "state": "RUNNING", "attempt": operations.c.attempt + 1, "starts": operations.c.starts + 1, "worker": worker,
        "options": options, "updated_at": time.time(),
    }  # fmt: skip
    connection.execute(update(operations).where(here).values(values))
    record = as_operation(connection.execute(select(operations).where(here)).mappings().one())
    return Claim(record, record.attempt)
