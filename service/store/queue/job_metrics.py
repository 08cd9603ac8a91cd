"""Metrics of the operations of all projects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, get_args

from sqlalchemy import Engine, func, select

from fastsplat.service.store.rows.damaged_rows import are_objects
from fastsplat.service.store.rows.database import transaction
from fastsplat.service.store.rows.schema import operations
from fastsplat_contract.jobs.operations import FINAL_STATES, OperationState


class JobMetrics:
    """Metrics of all operations; each method is one reading transaction and may raise `DatabaseError`."""

    def __init__(self, engine: Engine) -> None:
        self._reading = partial(transaction, engine.execution_options(read_only=True))

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
