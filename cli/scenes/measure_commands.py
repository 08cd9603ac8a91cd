"""`fastsplat objects measure` and `scale`: lengths in a scene, and its scale."""

from __future__ import annotations

from typing import Annotated

import typer

from fastsplat.cli.options import SceneId, Version, service_command
from fastsplat.cli.scenes.object_commands import objects_app
from fastsplat.cli.session import Session
from fastsplat.cli.tables import point
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.object_prompts import Pixel
from fastsplat_contract.geometry.places import KnownLength, KnownSize, Place
from fastsplat_contract.geometry.poses import Vector3
from fastsplat_contract.messages.measurements import Length, Measurement

_PLACE = "the id of an object (3), a point (0.1,0.2,0.3), or a pixel of one of the scene's cameras (front.png:120,80)"


@service_command(objects_app)
def measure(
    session: Session,
    scene: SceneId,
    places: Annotated[list[str], typer.Argument(help=f"One or two, each {_PLACE}.", metavar="PLACE...")],
    version: Version = "",
) -> None:
    """Measure a place, an object's size, or the distance of two places."""
    parsed_places = [_place(text) for text in places]
    scene_id = session.scene(scene)
    measured = session.client.measure(scene_id, *parsed_places, version=session.version(scene_id, version))
    session.tell(measured, _sentences(measured))


@service_command(objects_app)
def scale(
    session: Session,
    scene: SceneId,
    places: Annotated[
        list[str],
        typer.Argument(help=f"The id of an object, or two places: {_PLACE.partition(', ')[2]}.", metavar="PLACE..."),
    ],
    meters: Annotated[float, typer.Argument(help="The object's longest side, or how far the places are apart.")],
    height: Annotated[bool, typer.Option("--height", help="It is the object's height, not its longest side.")] = False,
    plus_minus: Annotated[float, typer.Option(help="Meters: how far off that may be, in 95 % of cases.")] = 0.0,
) -> None:
    """Make the scene's units meters by measured lengths or sizes; several are combined."""
    first, *rest = (_place(text) for text in places)
    known: KnownLength | KnownSize
    if first.object_id and not rest:
        known = KnownSize(first.object_id, meters, plus_minus, "height" if height else "longest")
    elif len(rest) == 1 and not height:
        known = KnownLength(first, rest[0], meters, plus_minus)
    else:
        raise InvalidInputError(
            f"a scale by {len(places)} places",
            field="places",
            hint="Name two places, or one object; --height is of an object.",
        )
    scene_id = session.scene(scene)
    new_version = session.client.scale_scene(scene_id, known)
    scaling = session.client.scene(scene_id).scaling
    assert scaling is not None
    session.tell(
        new_version,
        f"a unit of the trained scene is {scaling.meters_per_unit:.6g} m ({scaling.low:.6g} to {scaling.high:.6g}), "
        f"by {scaling.known_lengths} known lengths\nversion {new_version.version} is current",
    )


def _sentences(measured: Measurement) -> str:
    unit = "m" if measured.meters else "scene units"
    lines = []
    if measured.distance is not None:
        lines.append(f"{_length(measured.distance)} {unit} apart")
    if measured.center_distance is not None:
        lines.append(f"{_length(measured.center_distance)} {unit} from middle to middle")
    if measured.sides:
        lines.append(f"its sides are {', '.join(_length(side) for side in measured.sides)} {unit}")
    for place in measured.places:
        on = f"object {place.object_id} at " if place.object_id else ""
        lines.append(f"{on}{point(place.point)} {unit}, give or take {place.plus_minus:.3g}")
    return "\n".join(lines)


def _length(length: Length) -> str:
    return f"{length.value:.3g} ({length.low:.3g} to {length.high:.3g})"


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
        return Place(object_id=int(numbers))
    raise InvalidInputError(f"a place {text[:80]!r}", field="places", hint=f"Write {_PLACE}.")
