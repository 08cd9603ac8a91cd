"""Job queue: claims of workers to jobs, and updates fenced by the newest claim."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from itertools import zip_longest
from types import MappingProxyType
from typing import Any, Literal, TypeVar, get_args

from sqlalchemy import ColumnElement, Connection, RowMapping, Select, Update, and_, func, insert, select, update

from fastsplat.service.common.setting_groups import ModelChoice
from fastsplat.service.store.repositories.scene_repository import as_operation
from fastsplat.service.store.rows.damaged_rows import are_objects, each_readable, first_readable, is_time, require
from fastsplat.service.store.rows.database import Repository, upsert
from fastsplat.service.store.rows.records import REASONS, OperationRecord, QueuedJob
from fastsplat.service.store.rows.schema import QUEUE_ORDER, QUEUED, attempts, operations, turns
from fastsplat_contract.jobs.operations import FINAL_STATES, AgainAfter, JobAttempt, OperationState

LONGEST_PAUSE_S = 600.0
"""Jobs put off by more than twice this are due: the clock of the machine that put them off was ahead."""
_BEGUN = (operations.c.state == "RUNNING") & (operations.c.worker == "")


def _projects_in_turn() -> Select[Any]:
    """Selects the projects with queued jobs as `JobQueue.in_turn`, by a few look-ups in indexes for each."""
    project = operations.c.project
    first = select(func.min(project).label("project")).where(QUEUED)
    found = first.cte("found", recursive=True)
    later = first.where(project > found.c.project).scalar_subquery()
    found = found.union_all(select(later).where(found.c.project.is_not(None)))
    mine = project == found.c.project
    running = select(func.count()).where(operations.c.state == "RUNNING", mine).scalar_subquery()
    last = select(turns.c.last_at).where(turns.c.project == found.c.project).scalar_subquery()
    age = select(operations.c.created_at).where(QUEUED, mine).order_by(*QUEUE_ORDER).limit(1).scalar_subquery()
    query = select(found.c.project).where(found.c.project.is_not(None))
    return query.order_by(running, func.coalesce(last, 0.0), age)


_PROJECTS_IN_TURN = _projects_in_turn()  # built once, which takes longer than to run it

JobRequest = Literal["cancel", "finish"]
"""A request to a running job: stop, or end training early and keep the result."""


_J = TypeVar("_J", OperationRecord, QueuedJob)


class FencedError(Exception):
    """The claim is not its job's newest, or the job is over; work must stop."""


@dataclass(frozen=True)
class Claim:
    """The right to run a job until the next claim; `attempt` is the fencing token."""

    operation: OperationRecord
    attempt: int


def newest(claim: Claim) -> ColumnElement[bool]:
    """Builds the condition that a claim is its job's newest, and the job unfinished."""
    rows = operations.c
    return and_(rows.id == claim.operation.id, rows.attempt == claim.attempt, rows.state == "RUNNING")


def fenced(claim: Claim, *, uncancelled: bool = False) -> Update:
    """Builds an update of an unfinished operation that only its newest claim can make, and no cancellation forbids."""
    mine = update(operations).where(newest(claim))
    return mine.where(operations.c.cancel_requested.is_(False)) if uncancelled else mine


def end_attempt(connection: Connection, operation_id: str, why: AgainAfter | None) -> bool:
    """Ends the newest attempt of a job; False if it has ended already."""
    running = update(attempts).where(attempts.c.operation_id == operation_id, attempts.c.ended_at.is_(None))
    return connection.execute(running.values(ended_at=time.time(), why=why)).rowcount > 0


def execute_fenced(connection: Connection, claim: Claim, statement: Update) -> None:
    """Executes an update, or raises `FencedError` if it changes nothing."""
    if not connection.execute(statement).rowcount:
        raise FencedError(claim.operation.id)


class JobQueue(Repository):
    """The job queue; each method is one or two transactions and may raise `DatabaseError`."""

    def claim_next(
        self,
        worker: str,
        choice: ModelChoice = MappingProxyType({}),
        can_use: Callable[[ModelChoice], bool] = lambda choice: True,
        *,
        gpus: int = 0,
        memory: int = 1 << 62,
        only: str = "",
    ) -> Claim | None:
        """Claims the first job `in_turn` that is due and needs no more than the worker has, if any.

        Jobs begin with `choice`; those begun before keep their models, and are left if the worker cannot use these.
        With `only`, an operation's id, that job alone is claimed, in turn or not.
        """
        now = time.time()
        due = ~operations.c.run_after.between(now, now + 2 * LONGEST_PAUSE_S)
        fits = [due, operations.c.gpus <= gpus, operations.c.memory <= memory]
        if only:
            fits.append(operations.c.id == only)
        with self._reading() as connection:  # an idle worker takes no lock
            begun = each_readable(connection.execute(select(operations).where(_BEGUN, *fits)).mappings(), as_operation)
            projects = connection.scalars(_PROJECTS_IN_TURN).all()
        usable = [job.id for job in begun if can_use(job.models)]
        places = [_BEGUN & operations.c.id.in_(usable)] if usable else []
        if projects and can_use(choice):  # looked at once, as thousands may wait
            mine = [operations.c.id == only] if only else [operations.c.project == project for project in projects]
            places += [QUEUED & place for place in mine]
        if not places:
            return None
        with self._writing() as connection:
            for place in places:
                query = select(operations).where(place, *fits).order_by(*QUEUE_ORDER).with_for_update(skip_locked=True)
                for job in first_readable(connection, query, 1, as_operation):
                    return _begin(connection, job, worker, choice if job.state == "QUEUED" else None)
        return None

    def in_turn(self, most: int) -> Sequence[OperationRecord]:
        """Lists the jobs that no worker has, in the order in which they would begin; `most` queued ones a project.

        Those that were begun go first. Then projects take turns: first the one with the fewest jobs under way; of
        several, the one whose latest claim is longest ago, then the one whose next job has waited longest. Within a
        project priority decides, then age.
        """
        place = func.row_number().over(partition_by=operations.c.project, order_by=QUEUE_ORDER).label("place")
        first = select(operations.c.id, place).where(QUEUED).subquery()
        query = select(operations).where(operations.c.id.in_(select(first.c.id).where(first.c.place <= most)))
        return [*self.running(owned=False), *self._taking_turns(query, as_operation)]

    def queued_in_turn(self) -> Sequence[QueuedJob]:
        """Lists the queued jobs of `in_turn`, without most of their rows, as thousands may wait."""
        query = select(*(operations.c[column.name] for column in fields(QueuedJob))).where(QUEUED)
        return self._taking_turns(query, lambda row: QueuedJob(**row))

    def _taking_turns(self, query: Select[Any], read: Callable[[RowMapping], _J]) -> Sequence[_J]:
        with self._reading() as connection:
            jobs = each_readable(connection.execute(query.order_by(*QUEUE_ORDER)).mappings(), read)
            queued: dict[str, list[_J]] = {project: [] for project in connection.scalars(_PROJECTS_IN_TURN)}
        for job in jobs:
            queued.setdefault(job.project, []).append(job)
        return [job for jobs in zip_longest(*queued.values()) for job in jobs if job is not None]

    def running(self, *, owned: bool) -> Sequence[OperationRecord]:
        """Lists the begun jobs that a worker has, or those that none has."""
        query = select(operations).where(operations.c.state == "RUNNING", (operations.c.worker != "").is_(owned))
        with self._reading() as connection:
            return each_readable(connection.execute(query.order_by(*QUEUE_ORDER)).mappings(), as_operation)

    def claim(self, operation_id: str, worker: str = "") -> Claim | None:
        """Claims a waiting job out of turn, counts one start and fences earlier claims; None if it does not wait.

        Nobody else may claim it until `worker` (its executor id; "": nobody) ends or `take_back` is called.
        """
        waiting = select(operations).where(operations.c.id == operation_id, _BEGUN | QUEUED).with_for_update()
        with self._writing() as connection:
            row = connection.execute(waiting).mappings().first()
            return None if row is None else _begin(connection, as_operation(row), worker)

    def attempts_of(self, operation_ids: Sequence[str]) -> Mapping[str, tuple[JobAttempt, ...]]:
        """Maps operations to their readable attempts, oldest first."""
        query = select(attempts).where(attempts.c.operation_id.in_(operation_ids)).order_by(attempts.c.number)
        found: dict[str, tuple[JobAttempt, ...]] = dict.fromkeys(operation_ids, ())
        with self._reading() as connection:
            for row in connection.execute(query).mappings():
                found[row["operation_id"]] += tuple(each_readable((row,), as_attempt))
        return found

    def owners(self) -> Mapping[str, float]:
        """Maps workers with unfinished jobs to the latest update of these, in seconds since 1970."""
        conditions = operations.c.state == "RUNNING", operations.c.worker != ""
        latest = select(operations.c.worker, func.max(operations.c.updated_at)).where(*conditions)
        with self._reading() as connection:
            return dict(connection.execute(latest.group_by(operations.c.worker)).all())

    def take_back(self, worker: str) -> None:
        """Frees the unfinished jobs of a dead worker for others to claim."""
        with self._writing() as connection:
            unfinished = update(operations).where(operations.c.state == "RUNNING", operations.c.worker == worker)
            connection.execute(unfinished.values(worker=""))

    def jobs_by_state(self) -> Mapping[str, int]:
        """Counts operations by state, including states without any."""
        query = select(operations.c.state, func.count()).group_by(operations.c.state)
        with self._reading() as connection:
            counts = {str(row[0]): int(row[1]) for row in connection.execute(query)}
        return {**dict.fromkeys(get_args(OperationState), 0), **counts}

    def waits_since(self) -> float | None:
        """Time since which the longest waiting operation waits, in seconds since 1970; or None."""
        query = select(func.min(operations.c.updated_at)).where(QUEUED)
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


def as_attempt(row: RowMapping) -> JobAttempt:
    """Converts a row; of the worker's id without host and process, which callers need not know."""
    began_at, ended_at, why = row["began_at"], row["ended_at"], row["why"]
    readable = is_time(began_at) and (ended_at is None or is_time(ended_at)) and why in REASONS
    require(f"operation {row['operation_id']}", attempts=readable)
    ended = None if ended_at is None else datetime.fromtimestamp(ended_at, UTC)
    return JobAttempt(
        row["number"], row["worker"].rpartition("-")[2], datetime.fromtimestamp(began_at, UTC), ended, why
    )


def _begin(connection: Connection, job: OperationRecord, worker: str, models: ModelChoice | None = None) -> Claim:
    """Begins an attempt of a job whose row is locked, with its models or others; one that has not ended ends."""
    died = job.attempt > 0 and end_attempt(connection, job.id, "worker_died")
    now, number = time.time(), job.attempt + 1
    changes: dict[str, Any] = {
        "state": "RUNNING", "attempt": number, "starts": job.starts + 1, "updated_at": now,
        "models": dict(job.models if models is None else models),
        "again_after": "worker_died" if died else job.again_after,
    }  # fmt: skip
    connection.execute(update(operations).where(operations.c.id == job.id).values(worker=worker, **changes))
    connection.execute(insert(attempts).values(operation_id=job.id, number=number, worker=worker, began_at=now))
    upsert(connection, {turns.c.project: job.project, turns.c.last_at: now})
    return Claim(replace(job, **changes), number)
