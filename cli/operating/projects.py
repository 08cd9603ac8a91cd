"""`fastsplat projects`: whose scenes are apart from each other."""

from __future__ import annotations

from typing import Annotated

import typer

from fastsplat.cli.options import service_command
from fastsplat.cli.session import Session
from fastsplat.cli.tables import Column, minute, table
from fastsplat_contract.messages.projects import CreateProjectRequest

projects_app = typer.Typer(
    help="Projects: what is in one does not exist for the keys of another.", no_args_is_help=True
)


@service_command(projects_app)
def create(
    session: Session, name: Annotated[str, typer.Argument(help="Lower-case letters, digits and hyphens.")]
) -> None:
    """Make a project; only its own keys see its scenes, and they see no others."""
    from fastsplat_contract import calls  # every message of the contract

    project = session.client.call(calls.CREATE_PROJECT, CreateProjectRequest(name))
    session.tell(project, f"project {name} is there; make a key with: fastsplat keys create NAME --project {name}")


@service_command(projects_app, "list")
def list_projects(session: Session) -> None:
    """Show every project."""
    from fastsplat_contract import calls  # every message of the contract

    listed = session.client.call(calls.LIST_PROJECTS, None)
    columns = (Column("project", "cut"), Column("made"), Column("scenes", right=True), Column("keys", right=True))
    projects = listed.projects
    rows = [(project.name, minute(project.created_at), str(project.scenes), str(project.keys)) for project in projects]
    session.tell(listed, table(columns, rows))
