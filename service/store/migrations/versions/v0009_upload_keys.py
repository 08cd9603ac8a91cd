"""Keys for one upload; those of before have made none."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"


def upgrade() -> None:
    """Note of each key which operation it made."""
    op.add_column("api_keys", sa.Column("operation_id", sa.String(40), nullable=True))
