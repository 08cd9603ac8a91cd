"""What operators want to see of all jobs at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import Engine, func, select

from fastsplat.service.store.rows import transaction
from fastsplat.service.store.schema import operations

_STATES = ("QUEUED", "RUNNING", "SUCCEEDED", "FAILED", "CANCELLED")


class FigureRows:
    """Counts over the job rows; every method is one reading transaction and raises `DatabaseError`."""

    def __init__(self, engine: Engine) -> None:
        self._reading = engine.execution_options(read_only=True)

    def jobs_by_state(self) -> Mapping[str, int]:
        """How many operations are in each state; all states are there."""
        query = select(operations.c.state, func.count()).group_by(operations.c.state)
        with transaction(self._reading) as connection:
            counts = {str(row[0]): int(row[1]) for row in connection.execute(query)}
        return {**dict.fromkeys(_STATES, 0), **counts}

    def ended_since(self, moment: float) -> Sequence[tuple[str, float, Sequence[Mapping[str, Any]]]]:
        """(id, time of the last change, stages) of the operations that ended after `moment`."""
        query = select(operations.c.id, operations.c.updated_at, operations.c.stages).where(
            operations.c.updated_at > moment, operations.c.state.in_(_STATES[2:])
        )
        with transaction(self._reading) as connection:
            return [(row.id, row.updated_at, row.stages) for row in connection.execute(query)]
