"""What sources of suggestions had said of things that people named; of names given before, nothing is known."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"


def upgrade() -> None:
    """Add the column, empty."""
    op.add_column("known_names", sa.Column("said", sa.JSON, nullable=False, server_default="[]"))
