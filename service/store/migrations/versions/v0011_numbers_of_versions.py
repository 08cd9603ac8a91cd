"""Versions of a scene that an earlier release gave the same number have different ones again, in the order of age."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"


def upgrade() -> None:
    """Number the versions of each such scene anew: the trained one first, then by the time at which they were made."""
    names = ("scene_id", "version", "parent", "number", "created_at")
    versions = sa.table("scene_versions", *(sa.column(name) for name in names))
    connection = op.get_bind()
    doubled = sa.select(versions.c.scene_id).group_by(versions.c.scene_id, versions.c.number)
    for scene_id in set(connection.scalars(doubled.having(sa.func.count() > 1))):
        here = versions.c.scene_id == scene_id
        by_age = sa.select(versions.c.version).where(here)
        by_age = by_age.order_by(versions.c.parent != "", versions.c.created_at, versions.c.number)
        for number, version in enumerate(list(connection.scalars(by_age)), start=1):
            this = sa.update(versions).where(here, versions.c.version == version)
            connection.execute(this.values(number=number))
