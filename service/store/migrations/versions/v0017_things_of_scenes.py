"""How many things a scene has; those of before are counted when somebody first looks at them."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"


def upgrade() -> None:
    """Add the columns, empty: to count takes the scenes' files, which a database does not have."""
    op.add_column("scenes", sa.Column("things", sa.Integer, nullable=True))
    op.add_column("scene_versions", sa.Column("things", sa.Integer, nullable=True))
