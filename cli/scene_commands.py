"""`fastsplat scenes`: what became of the photos of a scene; rename it, train it further."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich import box
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from fastsplat.cli.local_service import local_service
from fastsplat.cli.waiting import wait_for
from fastsplat.service.planning.presets import preset_name
from fastsplat.service.store.records import DEFAULT_PROJECT
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.photo_verdicts import PhotoVerdict
from fastsplat_contract.places import Alignment, PointPair
from fastsplat_contract.poses import Vector3
from fastsplat_contract.scenes import Edit, SceneUpdate
from fastsplat_contract.train_more_messages import TrainMoreIn

if TYPE_CHECKING:
    pass

scenes_app = typer.Typer(
    name="scenes", help="Scenes: what became of their photos; rename them, train them.", no_args_is_help=True
)

SceneId = Annotated[str, typer.Argument(help="The scene's id.")]
Project = Annotated[str, typer.Option(help="The project whose scene it is.")]


@scenes_app.command()
def rename(
    scene: SceneId,
    name: Annotated[str, typer.Argument(help="Its new name; it need not be unique.")],
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Give a scene another name."""
    with local_service(project) as service:
        renamed = service.update_scene(scene, SceneUpdate(name))
    typer.echo(f"scene {renamed.id} is called {renamed.name!r}", err=True)


@scenes_app.command()
def photos(
    scene: SceneId,
    project: Project = DEFAULT_PROJECT,
    as_json: Annotated[bool, typer.Option("--json", help="Print a JSON array instead of a table.")] = False,
) -> None:
    """Show what became of each photo of a scene, and what to do about it."""
    listed: list[PhotoVerdict] = []
    with local_service(project) as service:
        page = service.list_photo_verdicts(scene)
        listed += page.photos
        while page.next_page_token:
            page = service.list_photo_verdicts(scene, page_token=page.next_page_token)
            listed += page.photos
    if as_json:
        typer.echo(json.dumps([to_plain(photo) for photo in listed], indent=2, ensure_ascii=False))
        return
    if not page.assessed:
        typer.echo(
            "nobody has looked at the photos of this scene: see the job, or it is of an earlier release", err=True
        )
        return
    table = Table(Column("photo", overflow="fold"), "verdict", "advice", box=box.SIMPLE, padding=(0, 1, 0, 0))
    for photo in listed:
        where = "placed" if photo.placed else f"not placed: {(photo.not_placed or 'unknown').replace('_', ' ')}"
        table.add_row(Text(photo.name), "\n".join((where, *photo.defects)), Text(photo.advice))
    Console().print(table)
    typer.echo(f"{page.placed_count} of {page.photo_count} photos have a place", err=True)


@scenes_app.command("train-more")
def train_more(
    scene: SceneId,
    seconds: Annotated[float | None, typer.Option(help="Of optimization.")] = None,
    steps: Annotated[int | None, typer.Option(help="Of optimization, instead of seconds.")] = None,
    preset: Annotated[str, typer.Option(help="draft, balanced or best. Default: the server's settings.")] = "",
    wait: Annotated[bool, typer.Option(help="Wait until a worker has done it, and print what came of it.")] = True,
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Train a scene further, from where it is, with the photos that are kept with it; a running worker does it."""
    with local_service(project) as service:
        order = TrainMoreIn(seconds, steps, preset_name(preset) if preset else None)
        operation = service.training.order(scene, order)
        typer.echo(f"operation {operation.id} is {operation.state}", err=True)
        operation = wait_for(service, operation) if wait else operation
    if wait and operation.state != "SUCCEEDED":
        raise typer.Exit(1)
    if operation.train_more is not None:
        typer.echo(json.dumps(to_plain(operation.train_more), indent=2))


@scenes_app.command("next-photos")
def next_photos(scene: SceneId, project: Project = DEFAULT_PROJECT) -> None:
    """Say where to stand for the next photos of a scene."""
    with local_service(project) as service:
        photos = service.photos.next_photos(scene).photos
    for photo in photos:
        typer.echo(photo.advice)
    if not photos:
        typer.echo("no place to stand at would add much", err=True)


@scenes_app.command()
def align(
    scene: SceneId,
    pairs: Annotated[
        Path,
        typer.Argument(help="CSV file, a line for each pair: x,y,z of the scene, then x,y,z of the map in meters."),
    ],
    frame: Annotated[str, typer.Option(help="Name of the map's frame.")] = "map",
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Put a scene into the frame of a map by three and more points that are known in both, as a new version."""
    try:
        numbers = np.loadtxt(pairs, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise InvalidInputError(f"{pairs} cannot be read: {error}", field="pairs") from error
    if numbers.shape[1:] != (6,):
        raise InvalidInputError(
            f"{pairs} has lines of {numbers.shape[-1]} numbers", field="pairs", limit="6 numbers a line"
        )
    rows = numbers.tolist()
    alignment = Alignment(frame, pairs=tuple(PointPair(Vector3(*row[:3]), Vector3(*row[3:])) for row in rows))
    with local_service(project) as service:
        made = service.versions.edit(scene, [Edit("align", alignment=alignment)])
        result = service.get_scene(scene).alignment
    assert result is not None and result.rms is not None
    typer.echo(f"the pairs fit to {result.rms:.4g} m (root mean square)")
    for number in result.outliers:
        typer.echo(f"line {number + 1} did not count: it is {result.residuals[number]:.4g} m off", err=True)
    typer.echo(f"version {made.version} is current")
