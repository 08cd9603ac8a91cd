"""`fastsplat things measure` and `scale`: lengths in a scene, and its scale by lengths that are known."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from fastsplat.cli.local_service import local_service
from fastsplat.cli.thing_commands import Project, Scene, Version, things_app
from fastsplat.service.store.records import DEFAULT_PROJECT
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.measure_messages import MeasureRequest
from fastsplat_contract.places import KnownLength, KnownSize, Place
from fastsplat_contract.poses import Vector3
from fastsplat_contract.scenes import Edit
from fastsplat_contract.thing_prompts import Pixel

_PLACE = "the id of a thing (3), a point (0.1,0.2,0.3), or a pixel of one of the scene's cameras (front.png:120,80)"


@things_app.command()
def measure(
    scene: Scene,
    places: Annotated[list[str], typer.Argument(help=f"One or two, each {_PLACE}.", metavar="PLACE...")],
    version: Version = "",
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Print how far two places are from each other, how large a thing is, or where a place is, as JSON."""
    request = MeasureRequest(scene, tuple(_place(text) for text in places), version)
    with local_service(project) as service:
        typer.echo(json.dumps(to_plain(service.answers.measure(request)), indent=2, ensure_ascii=False))


@things_app.command()
def scale(
    scene: Scene,
    first: Annotated[str, typer.Argument(help=f"From here: {_PLACE.partition(', ')[2]}.")],
    second: Annotated[str, typer.Argument(help="To there: a point or a pixel.")],
    meters: Annotated[float, typer.Argument(help="How far that is in the world.")],
    plus_minus: Annotated[float, typer.Option(help="Meters: how far off that may be, in 95 % of cases.")] = 0.0,
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Make the scene's units meters by a length that you have measured; several are combined."""
    known = KnownLength(_place(first), _place(second), meters, plus_minus)
    if not meters > 0 or not plus_minus >= 0:
        raise InvalidInputError(f"a length of {meters:g} m", field="meters", hint="Send a length above 0.")
    _scale(scene, Edit("scale", known_lengths=(known,)), project)


@things_app.command("scale-by-size")
def scale_by_size(
    scene: Scene,
    thing: Annotated[int, typer.Argument(help="The id of the thing.")],
    meters: Annotated[float, typer.Argument(help="Its size in the world.")],
    height: Annotated[bool, typer.Option("--height", help="That is its height, not its longest side.")] = False,
    plus_minus: Annotated[float, typer.Option(help="Meters: how far off that may be, in 95 % of cases.")] = 0.0,
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Make the scene's units meters by a thing whose size you know; combined with known lengths and tags."""
    if not meters > 0 or not plus_minus >= 0:
        raise InvalidInputError(f"a size of {meters:g} m", field="meters", hint="Send a size above 0.")
    known = KnownSize(thing, meters, plus_minus, "height" if height else "longest")
    _scale(scene, Edit("scale", known_sizes=(known,)), project)


def _scale(scene: str, edit: Edit, project: str) -> None:
    with local_service(project) as service:
        made = service.versions.edit(scene, [edit])
        scaling = service.get_scene(scene).scaling
    assert scaling is not None
    typer.echo(
        f"a unit of the trained scene is {scaling.meters_per_unit:.6g} m ({scaling.low:.6g} to {scaling.high:.6g}), "
        f"by {scaling.known_lengths} known lengths"
    )
    typer.echo(f"version {made.version} is current")


def _place(text: str) -> Place:
    view, _, numbers = text.rpartition(":")
    try:
        values = [float(part) for part in numbers.split(",")]
    except ValueError:
        values = []
    if view and len(values) == 2:
        return Place(view=view, pixel=Pixel(*values))
    if not view and len(values) == 3:
        return Place(point=Vector3(*values))
    if not view and numbers.isdecimal():
        return Place(thing=int(numbers))
    raise InvalidInputError(f"a place {text[:80]!r}", field="places", hint=f"Write {_PLACE}.")
