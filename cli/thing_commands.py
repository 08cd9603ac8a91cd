"""`fastsplat things`: list and pick the things of a scene, say where a robot sees one, name, merge, split, add, discard
and insert them, and look for more names."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer
from rich import box as boxes
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from fastsplat.cli.local_service import local_service
from fastsplat.cli.waiting import wait_for
from fastsplat.service.store.records import DEFAULT_PROJECT
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.look_again_messages import LookAgainIn
from fastsplat_contract.poses import Pose, Quaternion, Vector3
from fastsplat_contract.scenes import Edit, InsertSource
from fastsplat_contract.thing_messages import PickRequest, Pixel, PixelBox, SceneThing
from fastsplat_contract.thing_prompts import ThingPrompt

if TYPE_CHECKING:
    pass

things_app = typer.Typer(
    name="things",
    help="What a scene holds, named or not: list, pick, name, merge, split, add, discard, insert, look again.",
    no_args_is_help=True,
)  # fmt: skip


Scene = Annotated[str, typer.Argument(help="The scene's id.")]
Ids = Annotated[list[int], typer.Argument(help="Ids of things, from the list.", metavar="THING...")]
Project = Annotated[str, typer.Option(help="The project whose scene it is.")]
Version = Annotated[str, typer.Option(help="Of the scene. Default: the current one.")]
LookedAt = Annotated[
    str, typer.Option(help="The version that you looked at; only names that stood in it are replaced.")
]
View = Annotated[str, typer.Option(help="Name of one of the scene's cameras.")]
OnThing = Annotated[
    list[str], typer.Option(help="Of the view, on the thing; several are allowed.", metavar="X,Y", show_default=False)
]
BesideThing = Annotated[
    list[str],
    typer.Option(help="Of the view, beside the thing; several are allowed.", metavar="X,Y", show_default=False),
]
AroundThing = Annotated[
    tuple[float, float, float, float] | None, typer.Option(help="Of the view, around the thing: left top right bottom.")
]
NewName = Annotated[str | None, typer.Option(help="What it is.")]
Aliases = Annotated[list[str], typer.Option(help="Another name of it; several are allowed.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@things_app.command("list")
def list_things(
    scene: Scene,
    version: Version = "",
    parts: Annotated[bool, typer.Option("--parts", help="Show the parts of things as well.")] = False,
    project: Project = DEFAULT_PROJECT,
    as_json: Json = False,
) -> None:
    """Show every thing of a scene, by id."""
    things: list[SceneThing] = []
    with local_service(project) as service:
        page = service.answers.list_things(scene, version, parts=parts)
        things += page.things
        while page.next_page_token:
            page = service.answers.list_things(scene, page.version, page_token=page.next_page_token, parts=parts)
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
        place = "  " if thing.parent else ""
        table.add_row(f"{place}{thing.id}", Text(thing.name), source, Text(maybe), str(thing.gaussian_count))
    Console().print(table)


@things_app.command()
def goal(
    scene: Scene,
    thing: Annotated[int, typer.Argument(help="Id of a thing, from the list.")],
    radius: Annotated[float, typer.Option(help="Of the robot, meters; 0: 0.2.")] = 0.0,
    version: Version = "",
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Print where a robot stands to see a thing, as JSON; of scenes in meters with z up."""
    with local_service(project) as service:
        place = service.exports.goal(scene, thing, radius, version)
    typer.echo(json.dumps(to_plain(place), indent=2))


@things_app.command()
def detections(scene: Scene, version: Version = "", project: Project = DEFAULT_PROJECT) -> None:
    """Print every thing as a robot needs it, as JSON: pose with covariance, names, what carries it, who saw it."""
    with local_service(project) as service:
        whole = service.detections.all(scene, version)
        made = list(whole.detections)
        while whole.next_page_token:
            whole = service.detections.all(scene, whole.version, page_token=whole.next_page_token)
            made += whole.detections
    typer.echo(json.dumps(to_plain(whole._replace(detections=tuple(made))), indent=2, ensure_ascii=False))


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
    with local_service(project) as service:
        typer.echo(json.dumps(to_plain(service.answers.pick(request)), indent=2, ensure_ascii=False))


@things_app.command()
def name(
    scene: Scene,
    name: Annotated[str, typer.Argument(help="What they are.")],
    things: Ids,
    alias: Annotated[list[str], typer.Option(help="Another name of it; several are allowed.")] = [],
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


@things_app.command("look-again")
def look_again(
    scene: Scene,
    texts: Annotated[list[str], typer.Argument(help="What to look for, each in a word or two.", metavar="TEXT...")],
    wait: Annotated[bool, typer.Option(help="Wait until a worker has done it, and print what it found.")] = True,
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Search a scene for more names with the configured open-set detector; a running worker does it."""
    with local_service(project) as service:
        operation = service.look_again(scene, LookAgainIn(tuple(texts)))
        typer.echo(f"operation {operation.id} is {operation.state}", err=True)
        operation = wait_for(service, operation) if wait else operation
    if wait and operation.state != "SUCCEEDED":
        raise typer.Exit(1)
    if operation.look_again is not None:
        typer.echo(json.dumps(to_plain(operation.look_again), indent=2, ensure_ascii=False))


@things_app.command()
def insert(
    scene: Scene,
    source: Annotated[str, typer.Argument(help="The id of the scene that they come from, of the same project.")],
    things: Annotated[list[int], typer.Argument(help="Ids of things of that scene.", metavar="THING...")],
    position: Annotated[
        tuple[float, float, float],
        typer.Option(help="x y z here, in scene units, of the other scene's origin."),
    ] = (0.0, 0.0, 0.0),
    orientation: Annotated[
        tuple[float, float, float, float],
        typer.Option(help="Rotation from the other scene's world frame into this one's: a unit quaternion x y z w."),
    ] = (0.0, 0.0, 0.0, 1.0),
    source_version: Annotated[str, typer.Option(help="Of the other scene. Default: its current one.")] = "",
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Put things of another scene into this one; they get new ids and keep their names."""
    edit = Edit(
        "insert",
        things=tuple(things),
        transform=Pose(Vector3(*position), Quaternion(*orientation)),
        source=InsertSource(source, source_version),
    )
    _edit(scene, edit, "", project)


@things_app.command()
def split(
    scene: Scene,
    thing: Annotated[int, typer.Argument(help="Id of the thing, from the list.")],
    view: View = "",
    pixel: OnThing = [],
    beside: BesideThing = [],
    box: AroundThing = None,
    name: NewName = None,
    alias: Aliases = [],
    looked_at: LookedAt = "",
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Make the piece of a thing at a pixel or in a box of a view a thing of its own."""
    edit = Edit("split", things=(thing,), prompt=_prompt(view, pixel, beside, box), name=name, aliases=tuple(alias))
    _edit(scene, edit, looked_at, project)


@things_app.command()
def add(
    scene: Scene,
    view: View = "",
    pixel: OnThing = [],
    beside: BesideThing = [],
    box: AroundThing = None,
    name: NewName = None,
    alias: Aliases = [],
    looked_at: LookedAt = "",
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Make what is at a pixel or in a box of a view a thing, whatever it belonged to."""
    edit = Edit("add", prompt=_prompt(view, pixel, beside, box), name=name, aliases=tuple(alias))
    _edit(scene, edit, looked_at, project)


@things_app.command()
def undo(
    scene: Scene,
    version: Annotated[str, typer.Option(help="Undo only if this is the current version.")] = "",
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Go back to the version before the current one."""
    with local_service(project) as service:
        typer.echo(f"version {service.versions.undo(scene, version).version} is current")


@things_app.command()
def redo(
    scene: Scene,
    version: Annotated[str, typer.Option(help="Redo only if this is the current version.")] = "",
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Go forward to the version that was undone."""
    with local_service(project) as service:
        typer.echo(f"version {service.versions.redo(scene, version).version} is current")


@things_app.command()
def restore(
    scene: Scene,
    version: Annotated[str, typer.Argument(help="Which one, from the list of versions.")],
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Make any version current; all others stay."""
    with local_service(project) as service:
        typer.echo(f"version {service.versions.restore(scene, version).version} is current")


@things_app.command()
def versions(scene: Scene, project: Project = DEFAULT_PROJECT, as_json: Json = False) -> None:
    """Show every version of a scene, oldest first; a star marks the current one."""
    with local_service(project) as service:
        rows = service.versions.all(scene)
    if as_json:
        typer.echo(json.dumps([to_plain(row) for row in rows], indent=2, ensure_ascii=False))
        return
    table = Table(
        "", Column("version", no_wrap=True), "made of", "edits", "by", "made", box=boxes.SIMPLE, padding=(0, 1, 0, 0)
    )
    for row in rows:
        edits = Text(", ".join(edit.action for edit in row.edits) or "trained")
        made = f"{row.created_at:%Y-%m-%d %H:%M}"
        table.add_row("*" if row.current else "", row.version, row.parent, edits, Text(row.author), made)
    Console().print(table)


@things_app.command()
def known(
    forget: Annotated[str, typer.Option(help="Suggest the name of this id no more.")] = "",
    forget_all: Annotated[bool, typer.Option("--forget-all", help="Suggest none of them any more.")] = False,
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Show what people named in the project's scenes, which is suggested in its other scenes."""
    with local_service(project) as service:
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
    with local_service(project) as service:
        made = service.versions.edit(scene, [edit], looked_at=looked_at)
    for new in made.prompted:
        agree = f", seen in {len(new.views)} views" if len(new.views) > 1 else ", seen in one view"
        typer.echo(f"thing {new.thing_id} has {new.gaussian_count} Gaussians{agree}")
    typer.echo(f"version {made.version} is current")


def _prompt(
    view: str,
    pixels: list[str],
    beside: list[str],
    box: tuple[float, float, float, float] | None,
) -> ThingPrompt:
    return ThingPrompt(
        view=view or None,
        pixels=tuple(_pixel(text, "pixel") for text in pixels),
        background=tuple(_pixel(text, "beside") for text in beside),
        box=None if box is None else PixelBox(*box),
    )


def _pixel(text: str, option: str) -> Pixel:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InvalidInputError(
            f"a pixel at {text[:40]!r}", field=option, hint=f"Write --{option} X,Y, as in --{option} 120.5,80."
        ) from error
    return Pixel(x, y)
