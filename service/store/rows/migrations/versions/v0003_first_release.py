"""The tables of the first release."""

from __future__ import annotations

import time

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = None


def upgrade() -> None:
    """Makes the tables, and the default project."""
    projects = op.create_table(
        "projects",
        sa.Column("name", sa.String(64), primary_key=True),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("captioner_host", sa.String(300), nullable=False),
    )
    op.bulk_insert(projects, [{"name": "default", "created_at": time.time(), "captioner_host": ""}])
    op.create_table(
        "scenes",
        sa.Column("id", sa.String(40), primary_key=True),
        sa.Column("name", sa.String(1000), nullable=False),
        sa.Column("operation_id", sa.String(40), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("version", sa.String(80), nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("gaussians", sa.Integer, nullable=False),
        sa.Column("scale", sa.String(16), nullable=False),
        sa.Column("dictionary", sa.JSON, nullable=False),
        sa.Column("cameras", sa.JSON, nullable=False),
        sa.Column("quality", sa.JSON, nullable=False),
        sa.Column("scaling", sa.JSON),
        sa.Column("alignment", sa.JSON),
        sa.Column("objects", sa.Integer, nullable=False),
        sa.Column("project", sa.String(64), nullable=False),
    )
    op.create_index("scenes_newest_first", "scenes", ["project", "created_at", "id"])
    op.create_table(
        "operations",
        sa.Column("id", sa.String(40), primary_key=True),
        sa.Column("scene_id", sa.String(40), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("request_id", sa.String(200)),
        sa.Column("request_digest", sa.String(64), nullable=False),
        sa.Column("upload_id", sa.String(40), nullable=False),
        sa.Column("options", sa.JSON, nullable=False),
        sa.Column("stages", sa.JSON, nullable=False),
        sa.Column("error", sa.JSON),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("updated_at", sa.Double, nullable=False),
        sa.Column("attempt", sa.Integer, nullable=False),
        sa.Column("starts", sa.Integer, nullable=False),
        sa.Column("worker", sa.String(80), nullable=False),
        sa.Column("cancel_requested", sa.Boolean, nullable=False),
        sa.Column("finish_requested", sa.Boolean, nullable=False),
        sa.Column("progress_files", sa.JSON),
        sa.Column("priority", sa.Integer, nullable=False),
        sa.Column("project", sa.String(64), nullable=False),
        sa.Column("kind", sa.String(40), nullable=False, server_default=""),
        sa.Column("order", sa.JSON, nullable=False, server_default="{}"),
        sa.Column("result", sa.JSON(none_as_null=True)),
        sa.Column("retries", sa.Integer, nullable=False, server_default="0"),
        sa.Column("excluded", sa.JSON, nullable=False, server_default="[]"),
        sa.Column("attempts", sa.JSON, nullable=False, server_default="[]"),
        sa.UniqueConstraint("project", "request_id", name="operations_request"),
    )
    op.create_index("ix_operations_state", "operations", ["state"])
    op.create_table(
        "workers",
        sa.Column("executor_id", sa.String(80), primary_key=True),
        sa.Column("host", sa.String(255), nullable=False),
        sa.Column("pid", sa.Integer, nullable=False),
        sa.Column("started_at", sa.Double, nullable=False),
        sa.Column("heartbeat_at", sa.Double, nullable=False),
    )
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
        sa.Column("current_at", sa.Double),
        sa.Column("author", sa.String(200), nullable=False),
        sa.Column("scaling", sa.JSON),
        sa.Column("alignment", sa.JSON),
        sa.Column("quality", sa.JSON, nullable=False),
        sa.Column("objects", sa.Integer, nullable=False),
        sa.UniqueConstraint("scene_id", "request_id"),
    )
    op.create_table(
        "known_names",
        sa.Column("id", sa.String(60), primary_key=True),
        sa.Column("version", sa.String(80), primary_key=True),
        sa.Column("scene_id", sa.String(40), nullable=False),
        sa.Column("object_id", sa.Integer, nullable=False),
        sa.Column("name", sa.String(1000), nullable=False),
        sa.Column("named_at", sa.Double, nullable=False),
        sa.Column("appearance", sa.LargeBinary, nullable=False),
        sa.Column("picture", sa.LargeBinary, nullable=False),
        sa.Column("said", sa.JSON, nullable=False),
        sa.Column("tags", sa.JSON, nullable=False),
    )
    op.create_index("known_names_of_version", "known_names", ["scene_id", "version"])
    op.create_table(
        "scene_photos",
        sa.Column("scene_id", sa.String(40), primary_key=True),
        sa.Column("photos", sa.JSON, nullable=False),
    )
    op.create_table(
        "api_keys",
        sa.Column("id", sa.String(16), primary_key=True),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("role", sa.String(16), nullable=False),
        sa.Column("hash", sa.String(64), nullable=False),
        sa.Column("created_at", sa.Double, nullable=False),
        sa.Column("expires_at", sa.Double),
        sa.Column("revoked_at", sa.Double),
        sa.Column("operation_id", sa.String(40)),
        sa.Column("project", sa.String(64), nullable=False),
        sa.Column("scene_id", sa.String(40), nullable=False),
    )
    op.create_table(
        "quota_usage",
        sa.Column("scene_id", sa.String(40), primary_key=True),
        sa.Column("bytes", sa.BigInteger, nullable=False),
    )
    op.create_table(
        "identity",
        sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("id", sa.String(40), nullable=False),
    )
