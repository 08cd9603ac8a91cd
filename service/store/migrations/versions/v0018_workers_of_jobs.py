"""Which worker has a job stands in its row, and no longer in a queue beside it; of jobs under way nobody has one."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"


def upgrade() -> None:
    """Add the column, empty, and drop what the queue knew of."""
    op.add_column("operations", sa.Column("worker", sa.String(80), nullable=False, server_default=""))
    op.drop_column("operations", "enqueued")
