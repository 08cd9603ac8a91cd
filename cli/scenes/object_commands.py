"""`fastsplat objects`: list and pick objects, list known names, and search for more."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.options import SceneId, Version, Watch, service_command
from fastsplat.cli.scenes.export import write_file
from fastsplat.cli.session import Session
from fastsplat.cli.short_ids import LEAST, whole_id
from fastsplat.cli.tables import Column, minute, point, table
from fastsplat_contract import calls
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.messages.detections import Detection
from fastsplat_contract.messages.known_names import EVERY_NAME, KnownNameList
from fastsplat_contract.messages.objects import AskedLevel, ObjectList, PickedObject, SceneObject
from fastsplat_contract.messages.requests import GetContactSheetRequest

objects_app = typer.Typer(
    help="Objects of a scene: list, pick, measure, name, merge, split, add, discard, insert, look again.",
    no_args_is_help=True,
)


@service_command(objects_app, "list")
def list_objects(
    session: Session,
    scene: SceneId,
    version: Version = "",
    parts: Annotated[bool, typer.Option("--parts", help="Show the parts of objects as well.")] = False,
) -> None:
    """Show every object of a scene, by id."""
    scene_id = session.scene(scene)
    version = session.version(scene_id, version) or session.current(scene_id)
    objects = tuple(session.client.objects(scene_id, version=version, parts=parts))
    session.tell(ObjectList(objects, "", version), objects_table(objects), nothing="the scene has no objects")


def objects_table(objects: Sequence[SceneObject]) -> str:
    """Objects for people, a line each; "" without any."""
    columns = (
        Column("id"), Column("name", "cut"), Column("source"), Column("suggestions", "cut"), Column("says", "cut"),
        Column("Gaussians", right=True),
    )  # fmt: skip
    rows = [
        (
            f"{'  ' if obj.parent else ''}{obj.id}",
            obj.name,
            f"{_said_by(obj)} {obj.probability:.0%}" if obj.source else obj.surface,
            ", ".join(f"{name} {probability:.0%}" for name, probability, *_ in obj.suggestions),
            _said_on(obj),
            f"{obj.gaussian_count:,}",
        )
        for obj in objects
    ]
    return table(columns, rows)


@service_command(objects_app)
def sheet(
    session: Session,
    scene: SceneId,
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="JPEG to write; it is not there where nothing is shown.")
    ],
    page: Annotated[str, typer.Option(metavar="TOKEN", help="Of the next sheet, as the one before said.")] = "",
    version: Version = "",
) -> None:
    """Write a picture of at most 20 numbered objects without a name, and list them."""
    request = GetContactSheetRequest(*session.at(scene, version), page_token=page)
    contact_sheet = session.client.call(calls.GET_CONTACT_SHEET, request)
    if contact_sheet.picture:
        write_file(file, contact_sheet.picture)
    columns = (
        Column("no.", right=True), Column("id"), Column("size"), Column("beside", "cut"), Column("suggestions", "cut"),
    )  # fmt: skip
    rows = [
        (
            str(obj.number),
            str(obj.object_id),
            "" if obj.size is None else " × ".join(f"{side:.3g}" for side in obj.size),
            ", ".join(f"{near.object_id} {near.name}".rstrip() for near in obj.neighbors),
            ", ".join(f"{name} {probability:.0%}" for name, probability, *_ in obj.suggestions),
        )
        for obj in contact_sheet.objects
    ]
    session.tell(contact_sheet, table(columns, rows), nothing="no object is without a name")
    if contact_sheet.unseen and not session.as_json:
        typer.echo(f"no camera shows {', '.join(map(str, contact_sheet.unseen))}", err=True)
    if contact_sheet.next_page_token and not session.as_json:
        typer.echo(f"there are more: --page {contact_sheet.next_page_token}", err=True)


@service_command(objects_app)
def goal(
    session: Session,
    scene: SceneId,
    obj: Annotated[int, typer.Argument(metavar="OBJECT", help="Id of an object, from the list.")],
    radius: Annotated[float, typer.Option(help="Of the robot, meters; 0: 0.2.")] = 0.0,
    version: Version = "",
) -> None:
    """Say where a robot stands to see an object, in meters with z up."""
    scene_id, version = session.at(scene, version)
    place = session.client.goal(scene_id, obj, radius, version=version)
    session.tell(
        place,
        f"stand at {point(place.pose.position)} m, turned by {math.degrees(place.yaw):.0f}° from x: "
        f"{place.distance:.2f} m from object {place.object_id}, with {place.clearance:.2f} m free around",
    )


@service_command(objects_app)
def detections(session: Session, scene: SceneId, version: Version = "") -> None:
    """Show each object's position with uncertainty, its name, and the object that carries it."""
    scene_id, version = session.at(scene, version)
    whole = session.client.detection_page(scene_id, version=version)
    found = list(whole.detections)
    while whole.next_page_token:
        whole = session.client.detection_page(scene_id, version=whole.version, page_token=whole.next_page_token)
        found += whole.detections
    columns = (
        Column("id"), Column("name", "cut"), Column("center"), Column("±", right=True), Column("on or in", "cut"),
        Column("views", right=True),
    )  # fmt: skip
    session.tell(whole._replace(detections=tuple(found)), table(columns, list(map(_row, found))))
    if found and not session.as_json:
        unit = "meters" if whole.meters else "scene units"
        typer.echo(f"centers in {unit}; --json has poses, boxes and covariances", err=True)


@service_command(objects_app)
def pick(
    session: Session,
    scene: SceneId,
    view: Annotated[str, typer.Option(help="Name of one of the scene's cameras.")] = "",
    pixel: Annotated[tuple[float, float] | None, typer.Option(help="Of the view: x y.")] = None,
    box: Annotated[
        tuple[float, float, float, float] | None, typer.Option(help="Of the view: left top right bottom.")
    ] = None,
    at: Annotated[tuple[float, float, float] | None, typer.Option("--point", help="Of the scene: x y z.")] = None,
    level: Annotated[AskedLevel, typer.Option(help="Parts of the scene in the mask of --json.")] = "likeliest",
    version: Version = "",
) -> None:
    """Say which object, part and group is at a pixel, box or point."""
    scene_id, version = session.at(scene, version)
    picked = session.client.pick(scene_id, view or None, pixel=pixel, box=box, point=at, version=version, level=level)
    session.tell(picked, _picked(picked))


@service_command(objects_app, "look-again")
def look_again(
    session: Session,
    scene: SceneId,
    texts: Annotated[list[str], typer.Argument(help="Names to look for, a word or two each.", metavar="TEXT...")],
    watch: Watch = False,
) -> None:
    """Search a scene for more names with the configured open-set detector, by a job."""
    session.tell_job(session.client.look_again(session.scene(scene), texts), _seen, watch=watch)


@service_command(objects_app)
def known(
    session: Session,
    forget: Annotated[
        str,
        typer.Option(
            metavar="ID", help=f"Suggest this name no more; {LEAST} letters of its id will do. With all: none of them."
        ),
    ] = "",
) -> None:
    """Show what people named in the project's scenes, which is suggested in its other scenes."""
    known_names = session.client.known_names
    if forget:
        every = forget == EVERY_NAME
        known_names.forget(forget if every else whole_id("name", forget, (name.id for name in known_names.all())))
    names = tuple(known_names.all())
    columns = (Column("id"), Column("name", "cut"), Column("object", right=True), Column("named"))
    rows = [(name.id, name.name, str(name.object_id), minute(name.named_at)) for name in names]
    session.tell(KnownNameList(names, ""), table(columns, rows), nothing="no names are known")


def object_name(obj: SceneObject) -> str:
    """An object by its id and, if it has one, its name."""
    if not obj.name:
        return f"object {obj.id}, without a name"
    return f"object {obj.id}, {obj.name} ({_said_by(obj)} {obj.probability:.0%})"


def _said_by(obj: SceneObject) -> str:
    return "a guess," if obj.guess else str(obj.source)


def _said_on(obj: SceneObject) -> str:
    return " | ".join(read.text for read in obj.reads)


def _picked(picked: PickedObject) -> str:
    maybe = ", ".join(f"{name} {probability:.0%}" for name, probability, *_ in picked.object.suggestions)
    said = _said_on(picked.object)
    lines = [object_name(picked.object), f"maybe {maybe}" if maybe else "", f"says {said}" if said else ""]
    if picked.part is not None:
        lines.append(f"there its part: {object_name(picked.part)}")
    for choice in picked.levels:
        if choice.level == "group":
            lines.append(f"in group {choice.id}: objects {', '.join(map(str, choice.members))}")
    if len(picked.levels) > 1:
        meant = ", ".join(f"{choice.level} {choice.probability:.0%}" for choice in picked.levels)
        lines.append(f"meant: {meant}; the mask is of the {picked.level}")
    return "\n".join(line for line in lines if line)


def _row(detection: Detection) -> tuple[str, ...]:
    center = "" if detection.box is None else point(detection.box.center.position)
    variances = detection.position_covariance[::4]
    sure = f"{1.96 * math.sqrt(max(variances)):.3f}" if variances else ""
    support = detection.support
    on = "" if support is None else f"{support.relation} {support.label or f'object {support.object_id}'}"
    return str(detection.object_id), detection.label, center, sure, on, str(len(detection.views))


def _seen(operation: Operation) -> str:
    result = operation.look_again
    assert result is not None
    lines = [f"object {guess.object_id} is {guess.name} ({guess.probability:.0%})" for guess in result.named]
    lines += [f"object {guess.object_id} may be {guess.name} ({guess.probability:.0%})" for guess in result.suggested]
    if not result.named and not result.suggested:
        lines.append("nothing of that was found on an object")
    if result.unmatched:
        lines.append(f"{result.unmatched} of {result.regions} regions are no object of the scene")
    return "\n".join([*lines, f"version {result.version} is there"])
