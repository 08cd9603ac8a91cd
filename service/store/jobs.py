"""What workers do to operations. Every write carries the attempt that claimed the job: a late copy changes nothing."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Engine, delete, exists, insert, select, update

from fastsplat.service.store.records import OperationRecord, SceneSummary, WorkerRecord
from fastsplat.service.store.rows import as_operation
from fastsplat.service.store.schema import operations, scenes, workers


class FencedError(Exception):
    """Another worker has this job now, or nobody has; stop, and touch nothing of it."""


@dataclass(frozen=True)
class Claim:
    """The right to run a job, until somebody else claims it: attempts count up."""

    operation: OperationRecord
    attempt: int


class JobRows:
    """The queue's rows and the workers' heartbeats; every method is one transaction."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._reading = engine.execution_options(read_only=True)

    def waiting(self) -> Sequence[tuple[str, int]]:
        """(id, priority) of queued operations that no job engine knows of yet, in the order to run them."""
        query = select(operations.c.id, operations.c.priority).where(
            operations.c.state == "QUEUED", operations.c.enqueued.is_(False)
        )
        order = (operations.c.priority.desc(), operations.c.created_at, operations.c.id)
        with self._reading.connect() as connection:
            return [(row.id, row.priority) for row in connection.execute(query.order_by(*order))]

    def mark_enqueued(self, operation_id: str) -> None:
        """The job engine has it, durably."""
        with self._engine.begin() as connection:
            connection.execute(update(operations).where(operations.c.id == operation_id).values(enqueued=True))

    def claim(self, operation_id: str) -> Claim | None:
        """Start an attempt: counts one start and raises the fence. None if the operation is over or gone."""
        with self._engine.begin() as connection:
            running = update(operations).where(
                operations.c.id == operation_id, operations.c.state.in_(("QUEUED", "RUNNING"))
            )
            values = {
                "state": "RUNNING", "attempt": operations.c.attempt + 1, "starts": operations.c.starts + 1,
                "updated_at": time.time(),
            }  # fmt: skip
            if not connection.execute(running.values(values)).rowcount:
                return None
            row = connection.execute(select(operations).where(operations.c.id == operation_id)).mappings().one()
            record = as_operation(row)
            return Claim(record, record.attempt)

    def release(self, claim: Claim) -> None:
        """Give an unfinished job back without blame: its start does not count. Does nothing when fenced."""
        with self._engine.begin() as connection:
            values = {"starts": operations.c.starts - 1, "updated_at": time.time()}
            connection.execute(self._fenced(claim).values(values))

    def report(self, claim: Claim, stages: Sequence[Mapping[str, Any]]) -> bool:
        """Write progress. Returns whether somebody wants the job cancelled.

        Raises:
            FencedError: the claim is no longer the newest, or the operation is over.
        """
        with self._engine.begin() as connection:
            values = {"stages": [dict(stage) for stage in stages], "updated_at": time.time()}
            if not connection.execute(self._fenced(claim).values(values)).rowcount:
                raise FencedError(claim.operation.id)
            return self._cancel_requested(connection, claim)

    def check(self, claim: Claim) -> bool:
        """Whether somebody wants the job cancelled.

        Raises:
            FencedError: as `report`.
        """
        with self._reading.connect() as connection:
            here = select(operations.c.cancel_requested).where(
                operations.c.id == claim.operation.id,
                operations.c.attempt == claim.attempt,
                operations.c.state == "RUNNING",
            )
            wanted = connection.scalar(here)
        if wanted is None:
            raise FencedError(claim.operation.id)
        return bool(wanted)

    def succeed(self, claim: Claim, summary: SceneSummary) -> None:
        """Show the finished scene and end the operation, both at once.

        Raises:
            FencedError: as `report`; also when a cancellation came first, or the scene was deleted.
        """
        with self._engine.begin() as connection:
            done = self._fenced(claim).where(operations.c.cancel_requested.is_(False))
            if not connection.execute(done.values(state="SUCCEEDED", updated_at=time.time())).rowcount:
                raise FencedError(claim.operation.id)
            shown = update(scenes).where(scenes.c.id == claim.operation.scene_id)
            values = {
                "state": "READY", "version": summary.version, "gaussians": summary.gaussians, "scale": summary.scale,
                "dictionary": [dict(row) for row in summary.dictionary],
                "cameras": [dict(row) for row in summary.cameras], "quality": dict(summary.quality),
            }  # fmt: skip
            if not connection.execute(shown.values(values)).rowcount:
                raise FencedError(claim.operation.id)

    def fail(self, claim: Claim, error: Mapping[str, Any]) -> None:
        """End the operation as FAILED with its durable reason.

        Raises:
            FencedError: as `report`.
        """
        self._end(claim, "FAILED", dict(error))

    def cancelled(self, claim: Claim) -> None:
        """End the operation as CANCELLED.

        Raises:
            FencedError: as `report`.
        """
        self._end(claim, "CANCELLED", None)

    def beat(self, executor_id: str, host: str, pid: int) -> None:
        """Say that this executor lives."""
        now = time.time()
        with self._engine.begin() as connection:
            alive = update(workers).where(workers.c.executor_id == executor_id)
            if not connection.execute(alive.values(beat_at=now)).rowcount:
                row = {"executor_id": executor_id, "host": host, "pid": pid, "started_at": now, "beat_at": now}
                connection.execute(insert(workers).values(row))

    def alive_on(self, host: str, stale_s: float) -> bool:
        """Whether an executor of this host, as it named it in its beats, gave one in the last `stale_s` seconds."""
        fresh = workers.c.beat_at >= time.time() - stale_s
        query = select(workers.c.executor_id).where(workers.c.host == host, fresh).limit(1)
        with self._reading.connect() as connection:
            return connection.execute(query).first() is not None

    def workers(self) -> Sequence[WorkerRecord]:
        """All workers that have not been buried."""
        with self._reading.connect() as connection:
            return [WorkerRecord(**row) for row in connection.execute(select(workers)).mappings()]

    def resign(self, executor_id: str) -> None:
        """Make an executor's silence official at once: its work may be taken over."""
        with self._engine.begin() as connection:
            connection.execute(update(workers).where(workers.c.executor_id == executor_id).values(beat_at=0.0))

    def bury(self, executor_id: str) -> None:
        """Forget a dead executor after its work was handed on; one that comes back beats again."""
        with self._engine.begin() as connection:
            connection.execute(delete(workers).where(workers.c.executor_id == executor_id))

    def over(self, operation_ids: Sequence[str]) -> frozenset[str]:
        """Which of these operations have ended or do not exist."""
        alive = select(operations.c.id).where(operations.c.state.in_(("QUEUED", "RUNNING")))
        with self._reading.connect() as connection:
            return frozenset(operation_ids) - frozenset(connection.scalars(alive))

    def forget_ended(self, before: float) -> None:
        """Remove operations that ended before a moment (seconds since 1970) and have no scene (any more)."""
        gone = delete(operations).where(
            operations.c.updated_at < before,
            operations.c.state.in_(("SUCCEEDED", "FAILED", "CANCELLED")),
            ~exists().where(scenes.c.id == operations.c.scene_id),
        )
        with self._engine.begin() as connection:
            connection.execute(gone)

    def uploads(self) -> tuple[frozenset[str], frozenset[str]]:
        """Uploads that a queued or running operation needs, and those whose operation has ended."""
        with self._reading.connect() as connection:
            rows = connection.execute(select(operations.c.upload_id, operations.c.state)).all()
        live = frozenset(upload_id for upload_id, state in rows if state in ("QUEUED", "RUNNING"))
        return live, frozenset(upload_id for upload_id, _ in rows) - live

    def unknown_scenes(self, scene_ids: Sequence[str]) -> frozenset[str]:
        """Which of these scenes do not exist (any more)."""
        with self._reading.connect() as connection:
            return frozenset(scene_ids) - frozenset(connection.scalars(select(scenes.c.id)))

    def _end(self, claim: Claim, state: str, error: Mapping[str, Any] | None) -> None:
        with self._engine.begin() as connection:
            values = {"state": state, "error": error, "updated_at": time.time()}
            if not connection.execute(self._fenced(claim).values(values)).rowcount:
                raise FencedError(claim.operation.id)
            ended = update(scenes).where(scenes.c.id == claim.operation.scene_id, scenes.c.state == "TRAINING")
            connection.execute(ended.values(state="FAILED"))

    def _fenced(self, claim: Claim) -> Any:
        return update(operations).where(
            operations.c.id == claim.operation.id,
            operations.c.attempt == claim.attempt,
            operations.c.state == "RUNNING",
        )

    def _cancel_requested(self, connection: Any, claim: Claim) -> bool:
        here = select(operations.c.cancel_requested).where(operations.c.id == claim.operation.id)
        return bool(connection.scalar(here))
