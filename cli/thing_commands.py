"""`fastsplat things`: list the things of a scene, find the one at a pixel, name, merge and discard them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer
from rich import box as boxes
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from fastsplat.service.settings import load_settings
from fastsplat.service.store.records import DEFAULT_PROJECT
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.poses import Vector3
from fastsplat_contract.scenes import Edit
from fastsplat_contract.thing_messages import PickRequest, Pixel, PixelBox, SceneThing

if TYPE_CHECKING:
    from fastsplat.service.application.service import SceneService

things_app = typer.Typer(
    name="things", help="What a scene holds, with or without a name: list, pick, name, merge, discard.",
    no_args_is_help=True,
)  # fmt: skip

Scene = Annotated[str, typer.Argument(help="The scene's id.")]
Ids = Annotated[list[int], typer.Argument(help="Ids of things, from the list.", metavar="THING...")]
Project = Annotated[str, typer.Option(help="The project whose scene it is.")]
Version = Annotated[str, typer.Option(help="Of the scene. Default: the current one.")]
LookedAt = Annotated[
    str, typer.Option(help="The version that you looked at; only names that stood in it are replaced.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@things_app.command("list")
def list_things(scene: Scene, version: Version = "", project: Project = DEFAULT_PROJECT, as_json: Json = False) -> None:
    """Show every thing of a scene, by id."""
    things: list[SceneThing] = []
    with _service(project) as service:
        page = service.answers.list_things(scene, version)
        things += page.things
        while page.next_page_token:
            page = service.answers.list_things(scene, page.version, page_token=page.next_page_token)
            things += page.things
    if as_json:
        typer.echo(json.dumps([to_plain(thing) for thing in things], indent=2, ensure_ascii=False))
        return
    table = Table(
        "id", "name", Column("source", no_wrap=True), "suggestions", "Gaussians", box=boxes.SIMPLE, padding=(0, 1, 0, 0)
    )
    for thing in things:
        source = f"{thing.source} {thing.probability:.0%}" if thing.source else thing.surface
        maybe = ", ".join(f"{name} {probability:.0%}" for name, probability, _ in thing.suggestions)
        table.add_row(str(thing.id), Text(thing.name), source, Text(maybe), str(thing.gaussian_count))
    Console().print(table)


@things_app.command()
def pick(
    scene: Scene,
    view: Annotated[str, typer.Option(help="Name of one of the scene's cameras.")] = "",
    pixel: Annotated[tuple[float, float] | None, typer.Option(help="Of the view: x y.")] = None,
    box: Annotated[
        tuple[float, float, float, float] | None, typer.Option(help="Of the view: left top right bottom.")
    ] = None,
    point: Annotated[tuple[float, float, float] | None, typer.Option(help="Of the scene: x y z.")] = None,
    version: Version = "",
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Print the thing at a pixel or in a box of a view, or at a point of the scene, as JSON."""
    request = PickRequest(
        scene,
        view=view or None,
        pixel=None if pixel is None else Pixel(*pixel),
        box=None if box is None else PixelBox(*box),
        point=None if point is None else Vector3(*point),
        version=version,
    )
    with _service(project) as service:
        typer.echo(json.dumps(to_plain(service.answers.pick(request)), indent=2, ensure_ascii=False))


@things_app.command()
def name(
    scene: Scene,
    name: Annotated[str, typer.Argument(help="What they are.")],
    things: Ids,
    alias: Annotated[list[str], typer.Option(help="Another name of it; several are allowed.")] = [],  # noqa: B006
    looked_at: LookedAt = "",
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Give things a name."""
    _edit(scene, Edit("name", things=tuple(things), name=name, aliases=tuple(alias)), looked_at, project)


@things_app.command()
def unname(scene: Scene, things: Ids, looked_at: LookedAt = "", project: Project = DEFAULT_PROJECT) -> None:
    """Take the names of things away."""
    _edit(scene, Edit("unname", things=tuple(things)), looked_at, project)


@things_app.command()
def merge(scene: Scene, things: Ids, looked_at: LookedAt = "", project: Project = DEFAULT_PROJECT) -> None:
    """Make several things one, under the id and the name of the first."""
    _edit(scene, Edit("merge", things=tuple(things)), looked_at, project)


@things_app.command()
def discard(scene: Scene, things: Ids, looked_at: LookedAt = "", project: Project = DEFAULT_PROJECT) -> None:
    """Say that these are no things; their Gaussians stay."""
    _edit(scene, Edit("discard", things=tuple(things)), looked_at, project)


@things_app.command()
def undo(
    scene: Scene,
    version: Annotated[str, typer.Option(help="Undo only if this is the current version.")] = "",
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Go back to the version before the current one."""
    with _service(project) as service:
        typer.echo(f"version {service.versions.undo(scene, version).version} is current")


@things_app.command()
def known(
    forget: Annotated[str, typer.Option(help="Suggest the name of this id no more.")] = "",
    forget_all: Annotated[bool, typer.Option("--forget-all", help="Suggest none of them any more.")] = False,
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Show what people named in the project's scenes, which is suggested in its other scenes."""
    with _service(project) as service:
        if forget:
            service.known_names.forget(forget)
        if forget_all:
            service.known_names.forget_all()
        page = service.known_names.list()
        names = [*page.names]
        while page.next_page_token:
            page = service.known_names.list(page_token=page.next_page_token)
            names += page.names
    table = Table(Column("id", no_wrap=True), "name", "thing", "named", box=boxes.SIMPLE, padding=(0, 1, 0, 0))
    for name in names:
        table.add_row(name.id, Text(name.name), str(name.thing_id), f"{name.named_at:%Y-%m-%d %H:%M}")
    Console().print(table)


def _edit(scene: str, edit: Edit, looked_at: str, project: str) -> None:
    with _service(project) as service:
        made = service.versions.edit(scene, [edit], looked_at=looked_at)
    typer.echo(f"version {made.version} is current")


@contextmanager
def _service(project: str) -> Iterator[SceneService]:
    from fastsplat.service.application.service import open_service  # loads what answers questions

    with open_service(load_settings()) as service:
        yield service if project == DEFAULT_PROJECT else service.in_project(project)
