"""`fastsplat keys`: create, list and revoke access keys."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from fastsplat.service.application.keys import Keys
from fastsplat.service.settings import load_settings
from fastsplat.service.store import open_store

keys_app = typer.Typer(name="keys", help="Access keys: create, list, revoke them.", no_args_is_help=True)

_DAY_S = 86_400.0


@keys_app.command()
def create(
    name: Annotated[str, typer.Argument(help="Whose key it is, for people.")],
    read_only: Annotated[bool, typer.Option("--read-only", help="It may query and view, and change nothing.")] = False,
    days: Annotated[float | None, typer.Option(help="It expires after so many days. Default: never.")] = None,
) -> None:
    """Create a key and print it, this once: the database stores its hash alone."""
    with _keys() as keys:
        record, key = keys.create(name, "read" if read_only else "write", None if days is None else days * _DAY_S)
    typer.echo(f"key {record.id} ({record.kind}) for {name}; it is not shown again:", err=True)
    typer.echo(key)


@keys_app.command("list")
def list_keys() -> None:
    """Show every key ever made."""
    with _keys() as keys:
        records = keys.all()
    table = Table(title="Access keys")
    for heading in ("id", "kind", "state", "created", "expires", "name"):
        table.add_column(heading)
    now = time.time()
    for record in records:
        state = "valid" if record.valid(now) else "revoked" if record.revoked_at is not None else "expired"
        expires = "never" if record.expires_at is None else _day(record.expires_at)
        table.add_row(record.id, record.kind, state, _day(record.created_at), expires, record.name)
    Console().print(table)


@keys_app.command()
def revoke(key_id: Annotated[str, typer.Argument(help="The id from the list.")]) -> None:
    """Revoke a key; running servers refuse it within seconds."""
    with _keys() as keys:
        keys.revoke(key_id)
    typer.echo(f"key {key_id} is revoked", err=True)


@contextmanager
def _keys() -> Iterator[Keys]:
    settings = load_settings()
    store = open_store(settings.data_dir, settings.database_url)
    try:
        yield Keys(store.keys)
    finally:
        store.close()


def _day(moment: float) -> str:
    return datetime.fromtimestamp(moment, UTC).strftime("%Y-%m-%d %H:%M")
