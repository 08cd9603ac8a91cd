"""`fastsplat projects`: whose scenes are apart from each other."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

import typer

from fastsplat.cli.options import service_command
from fastsplat.cli.session import Session
from fastsplat.cli.tables import Column, minute, table

projects_app = typer.Typer(
    help="Projects: what is in one does not exist for the keys of another.", no_args_is_help=True
)


@service_command(projects_app)
def create(
    session: Session,
    name: Annotated[str, typer.Argument(help="Lower-case letters, digits and hyphens.")],
) -> None:
    """Make a project: its keys see its scenes only, and nobody else's keys see them. Then make keys for it."""
    from fastsplat.service.application.admin.projects import Projects

    with session.store() as store:
        Projects(store.projects).create(name)
    session.tell(
        {"name": name}, f"project {name} is there; make a key with: fastsplat keys create NAME --project {name}"
    )


@service_command(projects_app, "list")
def list_projects(session: Session) -> None:
    """Show every project."""
    from fastsplat.service.application.admin.projects import Projects

    with session.store() as store:
        records = Projects(store.projects).all()
    projects = [
        {
            "name": each.name,
            "created_at": datetime.fromtimestamp(each.created_at, UTC),
            "scenes": each.scenes,
            "keys": each.keys,
        }
        for each in records
    ]
    columns = (Column("project", "cut"), Column("made"), Column("scenes", right=True), Column("keys", right=True))
    rows = [
        (each.name, minute(datetime.fromtimestamp(each.created_at, UTC)), str(each.scenes), str(each.keys))
        for each in records
    ]
    session.tell({"projects": projects}, table(columns, rows))
