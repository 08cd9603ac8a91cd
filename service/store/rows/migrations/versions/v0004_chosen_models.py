"""The choice of models, and whatever other table a database lacks."""

from __future__ import annotations

from alembic import op

from fastsplat.service.store.rows.schema import metadata

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Makes the tables that are missing."""
    metadata.create_all(op.get_bind())
