"""The job queue: indexes, attempts as rows, turns of projects, leases, and needs as columns of jobs."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from fastsplat.service.store.rows.damaged_rows import are_objects, is_object
from fastsplat.service.store.rows.schema import attempts, metadata, operations
from fastsplat_contract.jobs.operations import FINAL_STATES

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Moves attempts and models out of their JSON columns; a new database has nothing of that."""
    connection = op.get_bind()
    metadata.create_all(connection)
    there = {column["name"] for column in sa.inspect(connection).get_columns("operations")}
    if "attempts" not in there:
        return
    for name in sorted({"run_after", "again_after", "gpus", "memory", "models"} - there):
        new = operations.c[name]
        op.add_column("operations", sa.Column(name, new.type, nullable=new.nullable, server_default=new.server_default))
    moved = operations.c.options, sa.column("attempts", sa.JSON)
    for row in connection.execute(sa.select(operations.c.id, operations.c.state, *moved)).all():
        past = row.attempts if are_objects(row.attempts, "number", "worker", "began_at", "ended_at", "why") else []
        for attempt in past:
            if attempt["began_at"] is not None:
                connection.execute(sa.insert(attempts).values(operation_id=row.id, **attempt))
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
