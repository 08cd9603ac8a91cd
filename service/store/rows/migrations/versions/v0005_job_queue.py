"""The job queue: indexes, attempts as rows, turns of projects, leases, and needs as columns of jobs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa
from alembic import op

from fastsplat.service.store.rows.damaged_rows import are_objects, is_object
from fastsplat.service.store.rows.schema import attempts, metadata, operations
from fastsplat_contract.jobs.operations import FINAL_STATES

revision = "0005"
down_revision = "0004"
_JSON = ("options", "attempts")
_ATTEMPT = ("number", "worker", "began_at", "ended_at", "why")


def upgrade() -> None:
    """Moves attempts and models out of their JSON columns; a new database has nothing of that."""
    connection = op.get_bind()
    metadata.create_all(connection)
    there = {column["name"] for column in sa.inspect(connection).get_columns("operations")}
    if "attempts" not in there:
        return
    for column in _columns():
        if column.name not in there:
            op.add_column("operations", column)
    columns = sa.column("id"), sa.column("state"), *(sa.column(name, sa.JSON) for name in _JSON)
    for row in connection.execute(sa.select(*columns).select_from(operations)).all():
        past = [dict(attempt) for attempt in row.attempts] if are_objects(row.attempts, *_ATTEMPT) else []
        for attempt in past:
            if attempt["began_at"] is not None:
                values = {name: attempt[name] for name in _ATTEMPT}
                connection.execute(sa.insert(attempts).values(operation_id=row.id, **values))
        over = row.state in FINAL_STATES
        before = past[:-1] if over else [attempt for attempt in past if attempt["ended_at"] is not None]
        changes = {"again_after": before[-1]["why"] if before else None}
        if is_object(row.options):
            options = dict(row.options)
            changes |= {"models": options.pop("models", None) or {}, "options": options}
        connection.execute(sa.update(operations).where(operations.c.id == row.id).values(changes))
    for name in ("ix_operations_state", "operations_queued"):  # a copied table would lose the order of the second
        op.execute(f"DROP INDEX IF EXISTS {name}")
    with op.batch_alter_table("operations") as batch:
        batch.drop_column("attempts")
    for index in operations.indexes:
        index.create(connection, checkfirst=True)


def _columns() -> Sequence[sa.Column[Any]]:
    return (
        sa.Column("run_after", sa.Double, nullable=False, server_default="0"),
        sa.Column("again_after", sa.String(16), nullable=True),
        sa.Column("gpus", sa.Integer, nullable=False, server_default="0"),
        sa.Column("memory", sa.BigInteger, nullable=False, server_default="0"),
        sa.Column("models", sa.JSON, nullable=False, server_default="{}"),
    )
