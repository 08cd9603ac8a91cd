"""What became of the photos of each scene's capture; scenes of before have none."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"


def upgrade() -> None:
    """Make the table, empty."""
    op.create_table(
        "scene_photos",
        sa.Column("scene_id", sa.String(40), primary_key=True),
        sa.Column("photos", sa.JSON, nullable=False),
    )
