"""Unfinished resumable uploads as rows, which all servers of a database share."""

from __future__ import annotations

from alembic import op

from fastsplat.service.store.rows.schema import metadata

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Makes the table; uploads that were under way begin anew."""
    metadata.create_all(op.get_bind())
