"""To which namer's host a project agreed that pictures may go; none before."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"


def upgrade() -> None:
    """Add the column, empty."""
    op.add_column("projects", sa.Column("namer_host", sa.String(300), nullable=False, server_default=""))
