"""`fastsplat keys` and `fastsplat projects`: create, list and revoke access keys, and the projects they belong to."""

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
from fastsplat.service.application.projects import Projects
from fastsplat.service.settings import load_settings
from fastsplat.service.store import Store, open_store
from fastsplat.service.store.key_repository import Role
from fastsplat.service.store.records import DEFAULT_PROJECT

keys_app = typer.Typer(name="keys", help="Access keys: create, list, revoke them.", no_args_is_help=True)
projects_app = typer.Typer(
    name="projects", help="Projects: what is in one does not exist for the keys of another.", no_args_is_help=True
)

_DAY_S = 86_400.0


@keys_app.command()
def create(
    name: Annotated[str, typer.Argument(help="Whose key it is, for people.")],
    role: Annotated[
        Role,
        typer.Option(
            help="reader: query and view; editor: also create and change; admin: also delete; operator: all that in "
            "any project."
        ),
    ] = "editor",
    project: Annotated[str, typer.Option(help="Whose scenes it sees.")] = DEFAULT_PROJECT,
    days: Annotated[float | None, typer.Option(help="It expires after so many days. Default: never.")] = None,
) -> None:
    """Create a key and print it, this once: the database stores its hash alone."""
    with _keys() as keys:
        record, key = keys.create(name, role, None if days is None else days * _DAY_S, project)
    typer.echo(f"key {record.id} ({record.role} in {record.project}) for {name}; it is not shown again:", err=True)
    typer.echo(key)


@keys_app.command("list")
def list_keys() -> None:
    """Show every key ever made."""
    with _keys() as keys:
        records = keys.all()
    table = Table(title="Access keys")
    for heading in ("id", "project", "role", "state", "created", "expires", "name"):
        table.add_column(heading)
    now = time.time()
    for record in records:
        state = "valid" if record.valid(now) else "revoked" if record.revoked_at is not None else "expired"
        expires = "never" if record.expires_at is None else _day(record.expires_at)
        table.add_row(record.id, record.project, record.role, state, _day(record.created_at), expires, record.name)
    Console().print(table)


@keys_app.command()
def revoke(key_id: Annotated[str, typer.Argument(help="The id from the list.")]) -> None:
    """Revoke a key; running servers refuse it within seconds."""
    with _keys() as keys:
        keys.revoke(key_id)
    typer.echo(f"key {key_id} is revoked", err=True)


@projects_app.command("create")
def create_project(
    name: Annotated[str, typer.Argument(help="Lower-case letters, digits and hyphens.")],
) -> None:
    """Make a project: its keys see its scenes only, and nobody else's keys see them. Then make keys for it."""
    with _opened_store() as store:
        Projects(store.projects).create(name)
    typer.echo(f"project {name} is there; make a key with: fastsplat keys create NAME --project {name}", err=True)


@projects_app.command("list")
def list_projects() -> None:
    """Show every project."""
    with _opened_store() as store:
        records = Projects(store.projects).all()
    table = Table(title="Projects")
    for heading in ("name", "created", "scenes", "keys"):
        table.add_column(heading)
    for record in records:
        table.add_row(record.name, _day(record.created_at), str(record.scenes), str(record.keys))
    Console().print(table)


@contextmanager
def _keys() -> Iterator[Keys]:
    with _opened_store() as store:
        yield Keys(store.keys, store.projects)


@contextmanager
def _opened_store() -> Iterator[Store]:
    settings = load_settings()
    store = open_store(settings.data_dir, settings.database_url)
    try:
        yield store
    finally:
        store.close()


def _day(moment: float) -> str:
    return datetime.fromtimestamp(moment, UTC).strftime("%Y-%m-%d %H:%M")
