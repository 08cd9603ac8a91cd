"""Job queue: claims of workers to jobs, and updates fenced by the newest claim."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from types import MappingProxyType
from typing import Any, Literal, get_args

from sqlalchemy import Connection, Update, func, select, update

from fastsplat.service.common.setting_groups import ModelChoice
from fastsplat.service.store.repositories.scene_repository import as_operation
from fastsplat.service.store.rows.damaged_rows import are_objects, each_readable
from fastsplat.service.store.rows.database import Repository
from fastsplat.service.store.rows.records import MODELS, Attempt, OperationRecord
from fastsplat.service.store.rows.schema import operations
from fastsplat_contract.jobs.operations import FINAL_STATES, AgainAfter, OperationState

_UNCLAIMED = (operations.c.state == "QUEUED") | ((operations.c.state == "RUNNING") & (operations.c.worker == ""))

JobRequest = Literal["cancel", "finish"]
"""A request to a running job: stop, or end training early and keep the result."""


class FencedError(Exception):
    """The claim is not its job's newest, or the job is over; work must stop."""


@dataclass(frozen=True)
class Claim:
    """The right to run a job until the next claim; `attempt` is the fencing token."""

    operation: OperationRecord
    attempt: int


def fenced(claim: Claim) -> Update:
    """Builds an update of an unfinished operation that only its newest claim can make."""
    return update(operations).where(
        operations.c.id == claim.operation.id, operations.c.attempt == claim.attempt, operations.c.state == "RUNNING"
    )


def uncancelled(claim: Claim) -> Update:
    """Builds a fenced update that also requires that no cancellation was requested."""
    return fenced(claim).where(operations.c.cancel_requested.is_(False))


def end_attempt(job: OperationRecord, why: AgainAfter | None) -> Sequence[Attempt]:
    """Returns a job's attempts, of which the newest ends now unless it has."""
    *earlier, newest = job.attempts or (None,)
    if newest is None or newest["ended_at"] is not None:
        return job.attempts
    return [*earlier, {**newest, "ended_at": time.time(), "why": why}]


def execute_fenced(connection: Connection, claim: Claim, statement: Update) -> None:
    """Executes an update, or raises `FencedError` if it changes nothing."""
    if not connection.execute(statement).rowcount:
        raise FencedError(claim.operation.id)


class JobQueue(Repository):
    """The job queue; each method is one or two transactions and may raise `DatabaseError`."""

    def waiting(self) -> Sequence[OperationRecord]:
        """Lists unclaimed operations, those begun before queued ones, by priority and age."""
        query = select(operations).where(_UNCLAIMED)
        order = (operations.c.state.desc(), operations.c.priority.desc(), operations.c.created_at, operations.c.id)
        with self._reading() as connection:
            return each_readable(connection.execute(query.order_by(*order)).mappings(), as_operation)

    def claim_next(
        self,
        worker: str,
        choice: ModelChoice = MappingProxyType({}),
        can_use: Callable[[ModelChoice], bool] = lambda choice: True,
    ) -> Claim | None:
        """Claims the first job `in_turn` whose models the worker can use, if any waits.

        Jobs begin with `choice`; those begun before keep theirs. Returns None also if another worker was faster.
        """
        waiting = self.in_turn()
        chosen = bool(waiting) and can_use(choice)  # once, as thousands may wait
        for job in waiting:
            begun = job.state == "RUNNING"
            if can_use(job.models) if begun else chosen:
                return self.claim(job.id, worker, job.models if begun else choice)
        return None

    def in_turn(self) -> Sequence[OperationRecord]:
        """Lists the jobs that no worker has, in the order in which they would begin.

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
        return [*begun, *(job for jobs in rounds for job in jobs if job is not None)]

    def under_way(self) -> Sequence[OperationRecord]:
        """Lists the jobs that a worker has."""
        query = select(operations).where(operations.c.state == "RUNNING", operations.c.worker != "")
        with self._reading() as connection:
            return each_readable(connection.execute(query).mappings(), as_operation)

    def claim(self, operation_id: str, worker: str = "", models: ModelChoice | None = None) -> Claim | None:
        """Claims a waiting job, counts one start and fences earlier claims.

        Nobody else may claim it until `worker` (its executor id; "": nobody) ends or `take_back` is called. It keeps
        `models`; None: those that it has. Returns None if it does not wait.
        """
        waiting = select(operations).where(operations.c.id == operation_id, _UNCLAIMED).with_for_update()
        with self._writing() as connection:
            row = connection.execute(waiting).mappings().first()
            if row is None:
                return None
            return _begin(connection, as_operation(row), "worker_died", worker, models)

    def claim_again(self, claim: Claim) -> Claim:
        """Starts another attempt after the trainer died; raises `FencedError` as `JobRepository.report`."""
        with self._writing() as connection:
            execute_fenced(connection, claim, fenced(claim).values(updated_at=time.time()))
            row = connection.execute(select(operations).where(operations.c.id == claim.operation.id)).mappings().one()
            return _begin(connection, as_operation(row), "trainer_died", row["worker"])

    def owners(self) -> Mapping[str, float]:
        """Maps workers with unfinished jobs to the latest update of these, in seconds since 1970."""
        conditions = operations.c.state == "RUNNING", operations.c.worker != ""
        latest = select(operations.c.worker, func.max(operations.c.updated_at)).where(*conditions)
        with self._reading() as connection:
            return dict(connection.execute(latest.group_by(operations.c.worker)).all())

    def take_back(self, worker: str) -> None:
        """Frees the unfinished jobs of a dead worker for others to claim."""
        with self._writing() as connection:
            connection.execute(update(operations).where(operations.c.worker == worker).values(worker=""))

    def jobs_by_state(self) -> Mapping[str, int]:
        """Counts operations by state, including states without any."""
        query = select(operations.c.state, func.count()).group_by(operations.c.state)
        with self._reading() as connection:
            counts = {str(row[0]): int(row[1]) for row in connection.execute(query)}
        return {**dict.fromkeys(get_args(OperationState), 0), **counts}

    def waits_since(self) -> float | None:
        """Time since which the longest waiting operation waits, in seconds since 1970; or None."""
        query = select(func.min(operations.c.updated_at)).where(operations.c.state == "QUEUED")
        with self._reading() as connection:
            since = connection.scalar(query)
        return None if since is None else float(since)

    def ended_since(self, moment: float) -> Sequence[tuple[str, float, Sequence[Mapping[str, Any]]]]:
        """Lists (id, time of the last change, stages) of the operations that ended after `moment`."""
        query = select(operations.c.id, operations.c.updated_at, operations.c.stages).where(
            operations.c.updated_at > moment, operations.c.state.in_(FINAL_STATES)
        )
        with self._reading() as connection:
            rows = connection.execute(query).all()
        return [(row.id, row.updated_at, row.stages) for row in rows if are_objects(row.stages)]


def _begin(
    connection: Connection, before: OperationRecord, after: AgainAfter, worker: str, models: ModelChoice | None = None
) -> Claim:
    """Begins an attempt; `after` is what ended the previous one, unless that is known."""
    earlier, here, now = end_attempt(before, after), operations.c.id == before.id, time.time()
    newest = Attempt(number=before.attempt + 1, worker=worker, began_at=now, ended_at=None, why=None)
    values = {
        "state": "RUNNING", "attempt": newest["number"], "starts": operations.c.starts + 1, "worker": worker,
        "attempts": [*earlier, newest], "updated_at": now,
    }  # fmt: skip
    if models not in (None, before.models):
        values["options"] = {**before.options, MODELS: dict(models)}
    connection.execute(update(operations).where(here).values(values))
    record = as_operation(connection.execute(select(operations).where(here)).mappings().one())
    return Claim(record, record.attempt)
