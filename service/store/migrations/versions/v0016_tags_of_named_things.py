"""The printed tags on things that people named; of names given before, none is known."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"


def upgrade() -> None:
    """Add the column, empty."""
    op.add_column("known_names", sa.Column("tags", sa.JSON, nullable=False, server_default="[]"))
