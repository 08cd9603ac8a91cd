"""Projects: scenes, operations, request ids and keys belong to one; everything that is there goes to the default one.

A key of the kind "write" could do everything that there was, deleting included, and becomes an admin of that project.
Quotas count by project, so who made a scene is not kept beside its bytes any more.
"""

from __future__ import annotations

import time

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"

_DEFAULT = "default"
_ROLES = {"read": "reader", "write": "admin"}


def upgrade() -> None:
    """Make the default project, and move everything into it."""
    projects = op.create_table(
        "projects",
        sa.Column("name", sa.String(64), primary_key=True),
        sa.Column("created_at", sa.Double, nullable=False),
    )
    op.bulk_insert(projects, [{"name": _DEFAULT, "created_at": time.time()}])
    for table in ("scenes", "api_keys"):
        op.add_column(table, _project())
    op.drop_index("scenes_newest_first", "scenes")
    op.create_index("scenes_newest_first", "scenes", ["project", "created_at", "id"])
    # The constraint was made without a name: PostgreSQL gave it this one, SQLite none.
    names = {"uq": "%(table_name)s_%(column_0_name)s_key"}
    with op.batch_alter_table("operations", naming_convention=names) as operations:
        operations.add_column(_project())
        operations.drop_constraint("operations_request_id_key", type_="unique")
        operations.create_unique_constraint("operations_request", ["project", "request_id"])
    op.drop_index("ix_holdings_owner", "holdings")
    with op.batch_alter_table("holdings") as holdings:
        holdings.drop_column("owner")
    # Until now a cancelled scene said FAILED.
    op.execute(
        "UPDATE scenes SET state = 'CANCELLED' WHERE state = 'FAILED' AND operation_id IN "
        "(SELECT id FROM operations WHERE state = 'CANCELLED')"
    )
    keys = sa.table("api_keys", sa.column("kind", sa.String))
    for old, new in _ROLES.items():
        op.execute(keys.update().where(keys.c.kind == old).values(kind=new))


def _project() -> sa.Column[str]:
    return sa.Column("project", sa.String(64), nullable=False, server_default=_DEFAULT)
