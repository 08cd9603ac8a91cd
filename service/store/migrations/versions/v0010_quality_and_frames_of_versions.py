"""How good each version is, and how it lies in the frame of a map."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"


def upgrade() -> None:
    """Add the columns, empty: versions of before are as good as their scene, and in no map."""
    op.add_column("scenes", sa.Column("alignment", sa.JSON, nullable=True))
    op.add_column("scene_versions", sa.Column("alignment", sa.JSON, nullable=True))
    op.add_column("scene_versions", sa.Column("quality", sa.JSON, nullable=True))
