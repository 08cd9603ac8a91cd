"""Roles of keys may have longer names."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"


def upgrade() -> None:
    """Make room for them; the rows stay as they are."""
    with op.batch_alter_table("api_keys") as keys:
        keys.alter_column("kind", type_=sa.String(16), existing_type=sa.String(8), existing_nullable=False)
