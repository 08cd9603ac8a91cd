"""Things are called objects."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from alembic import op

from fastsplat.service.common.earlier_names import renamed_keys

revision = "0003"
down_revision = "0002"

_JSON = (
    ("scene_versions", ("scene_id", "version"), ("edits",)),
    ("operations", ("id",), ("options", "order", "result")),
)
"""Tables, their primary keys, and the columns whose values name objects."""


def upgrade() -> None:
    """Renames columns, and fields within stored edits and options."""
    for renamed, old, new in (
        ("scenes", "things", "objects"),
        ("scene_versions", "things", "objects"),
        ("known_names", "thing_id", "object_id"),
    ):
        with op.batch_alter_table(renamed) as batch:
            batch.alter_column(old, new_column_name=new)
    connection = op.get_bind()
    for name, keys, columns in _JSON:
        values: list[sa.ColumnClause[Any]] = [sa.column(each, sa.JSON(none_as_null=True)) for each in columns]
        table = sa.table(name, *(sa.column(key) for key in keys), *values)
        for row in connection.execute(sa.select(table)).mappings().all():
            changed = {column: renamed_keys(row[column]) for column in columns}
            if changed != {column: row[column] for column in columns}:
                same = [table.c[key] == row[key] for key in keys]
                connection.execute(sa.update(table).where(*same).values(changed))
