"""A job's kind, order, result, retries and attempts move from its options to columns."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    """Adds the columns, and fills them; rows without readable options have no kind and stay damaged."""
    for column in (
        sa.Column("kind", sa.String(40), nullable=False, server_default=""),
        sa.Column("order", sa.JSON, nullable=False, server_default="{}"),
        sa.Column("result", sa.JSON(none_as_null=True)),
        sa.Column("retries", sa.Integer, nullable=False, server_default="0"),
        sa.Column("excluded", sa.JSON, nullable=False, server_default="[]"),
        sa.Column("attempts", sa.JSON, nullable=False, server_default="[]"),
    ):
        op.add_column("operations", column)
    connection = op.get_bind()
    jobs = sa.Table("operations", sa.MetaData(), autoload_with=connection)
    for row in connection.execute(sa.select(jobs)).mappings().all():
        options = row["options"]
        if isinstance(options, dict) and isinstance(options.get("retries", 0), int):
            moved = _moved(row, dict(options))
            connection.execute(sa.update(jobs).where(jobs.c.id == row["id"]).values(moved))


def _moved(row: sa.RowMapping, options: dict[str, Any]) -> dict[str, Any]:
    orders = {kind: options.pop(kind, None) for kind in ("look_again", "ask_namer")}
    kind = next((kind for kind, order in orders.items() if order is not None), "create_scene")
    return {
        "kind": kind,
        "order": orders.get(kind) or {},
        "result": options.pop("result", None) or sa.null(),
        "retries": options.pop("retries", 0),
        "excluded": options.pop("exclude", []),
        "attempts": _attempts(row, options.pop("again_after", None), released=options.pop("released", False)),
        "options": options,
    }


def _attempts(row: sa.RowMapping, again_after: str | None, *, released: bool) -> list[dict[str, Any]]:
    """The newest attempt and why the one before ended; their times were not stored, so these are bounds."""
    state, began, ended = row["state"], row["created_at"], row["updated_at"]
    newest = {"number": row["attempt"], "worker": row["worker"], "began_at": began, "ended_at": ended, "why": None}
    before = {**newest, "number": max(0, row["attempt"] - (state != "QUEUED")), "worker": "", "why": again_after}
    if state == "RUNNING":
        newest |= {"why": "worker_stopped"} if released else {"ended_at": None}
    elif state in ("FAILED", "CANCELLED"):
        newest["why"] = state.lower()
    return [*([before] if again_after else []), *([newest] if state != "QUEUED" else [])]
