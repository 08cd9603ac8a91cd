"""Keys that show one scene; those of before show all of their project."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    """Add the scene."""
    op.add_column("api_keys", sa.Column("scene_id", sa.String(40), nullable=False, server_default=""))
