"""An index by which a cleanup finds the operations of the uploads that it sees."""

from __future__ import annotations

from alembic import op

from fastsplat.service.store.rows.schema import operations

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    """Makes the indexes that are missing."""
    for index in operations.indexes:
        index.create(op.get_bind(), checkfirst=True)
