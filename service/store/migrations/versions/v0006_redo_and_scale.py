"""Which version a redo goes to, who made a version, and how its lengths were scaled."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Add the columns, empty."""
    op.add_column("scenes", sa.Column("scaling", sa.JSON, nullable=True))
    op.add_column("scene_versions", sa.Column("current_at", sa.Double, nullable=True))
    op.add_column("scene_versions", sa.Column("author", sa.String(200), nullable=False, server_default=""))
    op.add_column("scene_versions", sa.Column("scaling", sa.JSON, nullable=True))
