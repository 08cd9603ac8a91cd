"""Unfinished resumable uploads as rows, which all servers of a database share; operations are found by upload."""

from __future__ import annotations

from alembic import op

from fastsplat.service.store.rows.schema import metadata, operations

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Makes the table and the index; uploads that were under way begin anew."""
    metadata.create_all(op.get_bind())
    for index in operations.indexes:
        index.create(op.get_bind(), checkfirst=True)
