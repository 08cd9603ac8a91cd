"""`fastsplat scenes localize`: where photos were taken in a finished scene."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.options import SceneId, Version, service_command
from fastsplat.cli.scene_commands import scenes_app
from fastsplat.cli.session import Session
from fastsplat.cli.tables import point
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.json_codec import from_plain
from fastsplat_contract.localize_messages import LocalizedPhoto
from fastsplat_contract.poses import Pose


@service_command(scenes_app)
def localize(
    session: Session,
    scene: SceneId,
    photos: Annotated[list[Path], typer.Argument(help="Image files.", metavar="PHOTO...")],
    focal: Annotated[
        list[float],
        typer.Option(
            help="Focal length, pixels of the upright photo; one for all, or one for each. Default: found out."
        ),
    ] = [],
    poses: Annotated[
        Path | None,
        typer.Option(help="A JSON list, roughly where each photo was taken: they then find their place together."),
    ] = None,
    version: Version = "",
) -> None:
    """Say where photos were taken, what is seen from there, and of two or more what has changed; status 1 if a photo
    has no sure place."""
    rough = () if poses is None else _poses(poses)
    contents = [_bytes(path) for path in photos]
    scene_id = session.scene(scene)
    version = session.version(scene_id, version)
    answer = session.client.localize(scene_id, contents, focals=focal, poses=rough, version=version)
    unit = "m" if answer.meters else "scene units"
    lines = [_line(path.name, photo, unit) for path, photo in zip(photos, answer.photos, strict=True)]
    lines += [f"{change.sentence} ({change.probability:.0%}, {len(change.photos)} photos)" for change in answer.changes]
    session.tell(answer, "\n".join(lines))
    if any(photo.refusal is not None for photo in answer.photos):
        raise typer.Exit(1)


def _line(name: str, photo: LocalizedPhoto, unit: str) -> str:
    if photo.camera is None:
        return f"{name}: {photo.explanation}"
    seen = ", ".join(thing.name or f"thing {thing.thing_id}" for thing in photo.things[:5])
    where = point(photo.camera.world_from_camera[:3, 3].tolist())
    return f"{name}: at {where} {unit}" + (f"; shows {seen}" if seen else "")


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InvalidInputError(f"{path} cannot be read: {error.strerror}", field="photos") from error


def _poses(path: Path) -> tuple[Pose, ...]:
    try:
        rows = json.loads(_bytes(path))
    except ValueError as error:
        raise InvalidInputError(f"{path} is no JSON: {error}", field="poses") from error
    if not isinstance(rows, list):
        raise InvalidInputError(f"{path} holds no list", field="poses", hint="Write one pose for each photo.")
    return tuple(from_plain(Pose, row, f"poses[{number}]") for number, row in enumerate(rows))
