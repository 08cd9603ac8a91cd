"""The tables of the first release, which writes them out here: until then they stand in `schema` alone."""

from __future__ import annotations

import time

import sqlalchemy as sa
from alembic import op

from fastsplat.service.store.rows.schema import metadata, projects

revision = "0003"
down_revision = None


def upgrade() -> None:
    """Makes the tables, and the default project."""
    metadata.create_all(op.get_bind())
    row = {"name": "default", "created_at": time.time(), "captioner_host": ""}
    op.execute(sa.insert(projects).values(row))
