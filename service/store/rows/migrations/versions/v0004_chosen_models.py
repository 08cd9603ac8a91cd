"""Which models are in use is a choice of the deployment."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Makes the table; nothing is chosen."""
    op.create_table(
        "chosen_models",
        sa.Column("role", sa.String(40), primary_key=True),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("sha256", sa.JSON, nullable=False),
    )
