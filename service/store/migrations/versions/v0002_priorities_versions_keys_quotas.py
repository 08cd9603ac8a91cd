"""Priorities of jobs, versions of scenes, access keys, quotas.

The releases before alembic made tables that were missing whenever they opened a database, and counted its version in a
table of their own. So what of this revision a database has already depends on which of them opened it last.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    """Add what is not there yet."""
    database = sa.inspect(op.get_bind())
    if "priority" not in {column["name"] for column in database.get_columns("operations")}:
        op.add_column("operations", sa.Column("priority", sa.Integer, nullable=False, server_default="0"))
    op.create_table(
        "scene_versions",
        sa.Column("scene_id", sa.String(40), primary_key=True),
        sa.Column("version", sa.String(80), primary_key=True),
        sa.Column("number", sa.Integer, nullable=False),
        sa.Column("parent", sa.String(80), nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("request_id", sa.String(200)),
        sa.Column("request_digest", sa.String(64), nullable=False),
        sa.Column("gaussians", sa.Integer, nullable=False),
        sa.Column("dictionary", sa.JSON, nullable=False),
        sa.Column("edits", sa.JSON, nullable=False),
        sa.UniqueConstraint("scene_id", "request_id"),
        if_not_exists=True,
    )
    op.create_table(
        "api_keys",
        sa.Column("id", sa.String(16), primary_key=True),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("kind", sa.String(8), nullable=False),
        sa.Column("hash", sa.String(64), nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double),
        sa.Column("revoked_at", sa.Double),
        if_not_exists=True,
    )
    op.create_table(
        "holdings",
        sa.Column("scene_id", sa.String(40), primary_key=True),
        sa.Column("owner", sa.String(16), nullable=False),
        sa.Column("bytes", sa.BigInteger, nullable=False),
        if_not_exists=True,
    )
    op.create_index("ix_holdings_owner", "holdings", ["owner"], if_not_exists=True)
    op.create_table(
        "schema_version", sa.Column("version", sa.Integer, primary_key=True, autoincrement=False), if_not_exists=True
    )
