"""Names that people gave, with what the things look like; nothing of before has that."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Make the table, empty."""
    op.create_table(
        "known_names",
        sa.Column("id", sa.String(60), primary_key=True),
        sa.Column("version", sa.String(80), primary_key=True),
        sa.Column("scene_id", sa.String(40), nullable=False),
        sa.Column("thing_id", sa.Integer, nullable=False),
        sa.Column("name", sa.String(1000), nullable=False),
        sa.Column("named_at", sa.Double, nullable=False),
        sa.Column("appearance", sa.LargeBinary, nullable=False),
        sa.Column("picture", sa.LargeBinary, nullable=False),
    )
    op.create_index("known_names_of_version", "known_names", ["scene_id", "version"])
