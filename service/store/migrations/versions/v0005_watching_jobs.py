"""What a job shows of its scene while it makes it, and that its training is to end early; new for both."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Add the two columns; workers of an earlier release leave them as they are."""
    op.add_column("operations", sa.Column("finish_requested", sa.Boolean, nullable=False, server_default=sa.false()))
    op.add_column("operations", sa.Column("progress_files", sa.JSON(none_as_null=True), nullable=True))
