"""`fastsplat keys`: access keys of a project."""

from __future__ import annotations

from typing import Annotated

import typer

from fastsplat.cli.connection import link_to_share
from fastsplat.cli.lazy_settings import load_settings
from fastsplat.cli.options import SceneId, service_command
from fastsplat.cli.session import Session
from fastsplat.cli.short_ids import LEAST, SHORT
from fastsplat.cli.tables import Column, day, table
from fastsplat_contract.server.keys import KeyList, Role

keys_app = typer.Typer(help="Access keys of a project: create, share, list, revoke them.", no_args_is_help=True)

_DAY_S = 86_400.0

_KeyId = Annotated[str, typer.Argument(metavar="KEY", help=f"The id from the list, or {LEAST} letters of it or more.")]


@service_command(keys_app)
def create(
    session: Session,
    name: Annotated[str, typer.Argument(help="Whose key it is, for people.")],
    role: Annotated[
        Role,
        typer.Option(
            help="uploader: post one scene and watch its job; suggester: see objects without a name and suggest names; "
            "reader: query and view; editor: also create and change; admin: also delete, and keys of the project; "
            "operator: everything in any project."
        ),
    ] = "editor",
    days: Annotated[float | None, typer.Option(help="It expires after so many days. Default: never.")] = None,
) -> None:
    """Create a key and print it, this once: the database stores its hash alone."""
    new_key = session.client.keys.create(name, role, None if days is None else days * _DAY_S)
    typer.echo(f"key {new_key.key.id} ({role} in {new_key.key.project}) for {name}; it is not shown again:", err=True)
    session.tell(new_key, new_key.secret)


@service_command(keys_app)
def share(
    session: Session,
    scene: SceneId,
    name: Annotated[str, typer.Option(help="For whom, for people.")] = "link",
    days: Annotated[float, typer.Option(help="It expires after so many days.")] = 7.0,
    page: Annotated[str, typer.Option(help="Where people open the page. Default: the server's URL.")] = "",
) -> None:
    """Print a read-only link to one scene; it is listed and revoked as a key."""
    new_key = session.client.keys.share(session.scene(scene), name, days * _DAY_S)
    settings = load_settings()
    here = f"{'http' if settings.tls_cert is None else 'https'}://localhost:{settings.http_port}"
    typer.echo(f"key {new_key.key.id} shows scene {new_key.key.scene_id} alone, for {days:g} days:", err=True)
    session.tell(new_key, link_to_share(page or session.address.url or here, new_key))


@service_command(keys_app, "list")
def list_keys(session: Session) -> None:
    """Show every key that the project ever had, newest first; never the keys themselves."""
    keys = tuple(session.client.keys.all())
    columns = (
        Column("key"), Column("name", "cut"), Column("role"), Column("state"), Column("made"), Column("expires"),
        Column("scene"),
    )  # fmt: skip
    rows = [
        (
            key.id, key.name, key.role, key.state, day(key.created_at),
            "never" if key.expires_at is None else day(key.expires_at), key.scene_id[:SHORT],
        )
        for key in keys
    ]  # fmt: skip
    session.tell(KeyList(keys, ""), table(columns, rows), nothing="the project has no key")


@service_command(keys_app)
def revoke(session: Session, key: _KeyId) -> None:
    """Revoke a key for ever; running servers refuse it within seconds."""
    access_key = session.client.keys.revoke(session.key(key))
    session.tell(access_key, f"key {access_key.id} is revoked")
