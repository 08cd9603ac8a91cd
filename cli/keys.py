"""`fastsplat keys` and `fastsplat projects`: access keys, and the projects they belong to."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from fastsplat.cli.local_service import local_store
from fastsplat.cli.remote import Ca, KeyFile, Server, connect, link_to_share
from fastsplat.service.settings import load_settings
from fastsplat.service.store.records import DEFAULT_PROJECT
from fastsplat_contract.keys import KeyIn, Role

if TYPE_CHECKING:
    from fastsplat.service.application.admin.keys import Keys

keys_app = typer.Typer(
    name="keys", help="Access keys: create, list, expire, revoke them, here or on a server.", no_args_is_help=True
)
projects_app = typer.Typer(
    name="projects", help="Projects: what is in one does not exist for the keys of another.", no_args_is_help=True
)

_DAY_S = 86_400.0

_KeyId = Annotated[str, typer.Argument(help="The id from the list.")]
_Project = Annotated[
    str, typer.Option(help="Whose scenes it sees. Default: by --server your own key's project, else the default one.")
]


@keys_app.command()
def create(
    name: Annotated[str, typer.Argument(help="Whose key it is, for people.")],
    role: Annotated[
        Role,
        typer.Option(
            help="uploader: post one scene and watch its job; reader: query and view; editor: also create and change; "
            "admin: also delete, and keys of the project; operator: all that in any project."
        ),
    ] = "editor",
    project: _Project = "",
    days: Annotated[float | None, typer.Option(help="It expires after so many days. Default: never.")] = None,
    server: Server = "",
    key_file: KeyFile = None,
    ca: Ca = None,
) -> None:
    """Create a key and print it, this once: the database stores its hash alone."""
    lifetime_s = None if days is None else days * _DAY_S
    if server:
        with connect(server, key_file, ca, project) as client:
            made = client.keys.create(name, role, lifetime_s)
        key_id, where, secret = made.key.id, made.key.project, made.secret
    else:
        with _keys() as keys:
            record, secret = keys.create(name, role, lifetime_s, project or DEFAULT_PROJECT)
        key_id, where = record.id, record.project
    typer.echo(f"key {key_id} ({role} in {where}) for {name}; it is not shown again:", err=True)
    typer.echo(secret)


@keys_app.command()
def share(
    scene: Annotated[str, typer.Argument(help="The scene's id.")],
    name: Annotated[str, typer.Option(help="For whom, for people.")] = "link",
    days: Annotated[float, typer.Option(help="It expires after so many days.")] = 7.0,
    project: _Project = "",
    page: Annotated[str, typer.Option(help="Where people open the page. Default: the server's URL.")] = "",
    server: Server = "",
    key_file: KeyFile = None,
    ca: Ca = None,
) -> None:
    """Print a link that shows one scene, read-only, to whoever has it; list and revoke it as any key."""
    request = KeyIn(name, "reader", days * _DAY_S, scene)
    if server:
        with connect(server, key_file, ca, project) as client:
            made = client.keys.share(scene, name, days * _DAY_S)
    else:
        from fastsplat.service.application.admin.project_keys import ProjectKeys

        own = project or DEFAULT_PROJECT
        with local_store() as store:
            made = ProjectKeys(store.in_project(own), load_settings(), own).create("operator", request)
    settings = load_settings()
    scheme = "http" if settings.tls_cert is None else "https"
    typer.echo(f"key {made.key.id} shows scene {scene} alone, for {days:g} days:", err=True)
    typer.echo(link_to_share(page or server or f"{scheme}://localhost:{settings.http_port}", made))


@keys_app.command("list")
def list_keys(project: _Project = "", server: Server = "", key_file: KeyFile = None, ca: Ca = None) -> None:
    """Show every key ever made; by --server, those of the project."""
    if server:
        with connect(server, key_file, ca, project) as client:
            records = sorted(client.keys.all(), key=lambda key: key.created_at)
    else:
        from fastsplat.service.application.admin.project_keys import as_key

        now = time.time()
        with _keys() as keys:
            records = [as_key(record, now) for record in keys.all() if project in ("", record.project)]
    table = Table(title="Access keys")
    for heading in ("id", "project", "role", "state", "created", "expires", "name", "only scene"):
        table.add_column(heading, no_wrap=heading == "id")  # whole on narrow terminals: other commands take it
    for key in records:
        expires = "never" if key.expires_at is None else _minute(key.expires_at)
        table.add_row(
            key.id, key.project, key.role, key.state.lower(), _minute(key.created_at), expires, key.name, key.scene_id
        )
    Console().print(table)


@keys_app.command()
def revoke(
    key_id: _KeyId, project: _Project = "", server: Server = "", key_file: KeyFile = None, ca: Ca = None
) -> None:
    """Revoke a key for ever; running servers refuse it within seconds."""
    if server:
        with connect(server, key_file, ca, project) as client:
            client.keys.revoke(key_id)
    else:
        with _keys() as keys:
            keys.revoke(key_id)
    typer.echo(f"key {key_id} is revoked", err=True)


@keys_app.command()
def expire(
    key_id: _KeyId,
    days: Annotated[float, typer.Option(help="It expires in so many days from now, sooner or later than it would.")],
    project: _Project = "",
    server: Server = "",
    key_file: KeyFile = None,
    ca: Ca = None,
) -> None:
    """Let a valid key expire at another time."""
    if server:
        with connect(server, key_file, ca, project) as client:
            client.keys.expire(key_id, days * _DAY_S)
    else:
        with _keys() as keys:
            keys.expire(key_id, days * _DAY_S)
    typer.echo(f"key {key_id} expires in {days:g} days", err=True)


@projects_app.command("create")
def create_project(
    name: Annotated[str, typer.Argument(help="Lower-case letters, digits and hyphens.")],
) -> None:
    """Make a project: its keys see its scenes only, and nobody else's keys see them. Then make keys for it."""
    from fastsplat.service.application.admin.projects import Projects

    with local_store() as store:
        Projects(store.projects).create(name)
    typer.echo(f"project {name} is there; make a key with: fastsplat keys create NAME --project {name}", err=True)


@projects_app.command("list")
def list_projects() -> None:
    """Show every project."""
    from fastsplat.service.application.admin.projects import Projects

    with local_store() as store:
        records = Projects(store.projects).all()
    table = Table(title="Projects")
    for heading in ("name", "created", "scenes", "keys"):
        table.add_column(heading)
    for record in records:
        table.add_row(
            record.name, _minute(datetime.fromtimestamp(record.created_at, UTC)), str(record.scenes), str(record.keys)
        )
    Console().print(table)


@contextmanager
def _keys() -> Iterator[Keys]:
    from fastsplat.service.application.admin.keys import Keys

    with local_store() as store:
        yield Keys(store.keys, store.projects)


def _minute(moment: datetime) -> str:
    return moment.strftime("%Y-%m-%d %H:%M")
