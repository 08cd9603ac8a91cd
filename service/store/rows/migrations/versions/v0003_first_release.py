"""The tables of the first release, which writes them out here: until then they stand in `schema` alone."""

from __future__ import annotations

import time

import sqlalchemy as sa
from alembic import context, op

from fastsplat.service.store.rows.schema import metadata, projects

revision = "0003"
down_revision = None


def upgrade() -> None:
    """Makes the tables, and the default project."""
    metadata.create_all(op.get_bind())
    if str(context.get_revision_argument()) < "0005":  # for the rows of a database that is about to be upgraded
        op.add_column("operations", sa.Column("attempts", sa.JSON, nullable=False, server_default="[]"))
    row = {"name": "default", "created_at": time.time(), "captioner_host": ""}
    op.execute(sa.insert(projects).values(row))
