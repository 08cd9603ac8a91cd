"""Names that were learnt elsewhere; no project has any before."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"


def upgrade() -> None:
    """Add the table, empty."""
    op.create_table(
        "name_packs",
        sa.Column("id", sa.String(40), primary_key=True),
        sa.Column("license", sa.Text, nullable=False),
        sa.Column("model", sa.String(200), nullable=False),
        sa.Column("digest", sa.String(64), nullable=False),
        sa.Column("names", sa.JSON, nullable=False),
        sa.Column("count", sa.Integer, nullable=False),
        sa.Column("added_at", sa.Double, nullable=False),
        sa.Column("project", sa.String(64), nullable=False, server_default="default"),
    )
