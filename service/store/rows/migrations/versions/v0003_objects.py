"""Things are called objects, and the namer captioner."""

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
    """Renames columns, and within stored edits and jobs."""
    for renamed, old, new in (
        ("scenes", "things", "objects"),
        ("scene_versions", "things", "objects"),
        ("known_names", "thing_id", "object_id"),
        ("projects", "namer_host", "captioner_host"),
    ):
        with op.batch_alter_table(renamed) as batch:
            batch.alter_column(old, new_column_name=new)
    op.execute("UPDATE operations SET kind = 'ask_captioner' WHERE kind = 'ask_namer'")
    connection = op.get_bind()
    for name, keys, columns in _JSON:
        values: list[sa.ColumnClause[Any]] = [sa.column(column, sa.JSON(none_as_null=True)) for column in columns]
        table = sa.table(name, *(sa.column(key) for key in keys), *values)
        for row in connection.execute(sa.select(table)).mappings().all():
            changed = {column: renamed_keys(row[column]) for column in columns}
            if changed != {column: row[column] for column in columns}:
                same = [table.c[key] == row[key] for key in keys]
                connection.execute(sa.update(table).where(*same).values(changed))
