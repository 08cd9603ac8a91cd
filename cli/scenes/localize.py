"""`fastsplat scenes localize` and `observe`: photos of another day in a finished scene."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.options import SceneId, Version, service_command
from fastsplat.cli.scenes.scene_commands import scenes_app
from fastsplat.cli.session import Session
from fastsplat.cli.short_ids import SHORT
from fastsplat.cli.tables import minute, point
from fastsplat_contract.codec.json_codec import from_plain
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.poses import Pose
from fastsplat_contract.photos.localization import LocalizedPhoto
from fastsplat_contract.photos.observations import Observation, ObservationList

_Focal = Annotated[
    list[float], typer.Option(help="Focal length in pixels of the upright photo, for all or each. Default: estimated.")
]


@service_command(scenes_app)
def localize(
    session: Session,
    scene: SceneId,
    photos: Annotated[list[Path], typer.Argument(help="Image files.", metavar="PHOTO...")],
    focal: _Focal = [],
    poses: Annotated[
        Path | None,
        typer.Option(help="A JSON list, roughly where each photo was taken: they then find their place together."),
    ] = None,
    version: Version = "",
) -> None:
    """Find where photos were taken, and what has changed; status 1 without a sure place."""
    rough = () if poses is None else _poses(poses)
    contents = [_bytes(path) for path in photos]
    scene_id, version = session.at(scene, version)
    answer = session.client.localize(scene_id, contents, focals=focal, poses=rough, version=version)
    unit = "m" if answer.meters else "scene units"
    lines = [_line(path.name, photo, unit) for path, photo in zip(photos, answer.photos, strict=True)]
    lines += [f"{change.sentence} ({change.probability:.0%}, {len(change.photos)} photos)" for change in answer.changes]
    session.tell(answer, "\n".join(lines))
    if any(photo.refusal is not None for photo in answer.photos):
        raise typer.Exit(1)


@service_command(scenes_app)
def observe(
    session: Session,
    scene: SceneId,
    photos: Annotated[list[Path], typer.Argument(help="Image files, or folders of them.", metavar="PHOTO...")],
    seen_at: Annotated[
        datetime | None,
        typer.Option(help="When they were taken, in this machine's time zone. Default: by their metadata, or now."),
    ] = None,
    focal: _Focal = [],
) -> None:
    """Keep photos of another day, and say what is gone, moved, new or changed.

    `objects undo` takes them back.
    """
    files = [file for path in photos for file in _files(path)]
    contents = [_bytes(path) for path in files]
    when = None if seen_at is None else seen_at.astimezone()
    observation = session.client.observe(session.scene(scene), contents, focals=focal, seen_at=when)
    session.tell(observation, _observation_text(observation))


@service_command(scenes_app)
def observations(session: Session, scene: SceneId, version: Version = "") -> None:
    """Say what photos of other days showed, the newest first."""
    scene_id, version = session.at(scene, version)
    listed = tuple(session.client.observations(scene_id, version=version))
    text = "\n".join(map(_observation_text, listed)) or "no photos of another day are kept with this scene"
    session.tell(ObservationList(listed, "", version), text)


def _observation_text(observation: Observation) -> str:
    photos = f"{len(observation.photos)} photos of {minute(observation.seen_at)}"
    lines = [f"{observation.id[:SHORT]}: {photos}: {len(observation.looked_at)} objects were looked at"]
    lines += [
        f"  {change.sentence} ({change.probability:.0%}, {len(change.photos)} photos)" for change in observation.changes
    ] or [f"  {observation.sentence}"]
    return "\n".join([*lines, *(f"  left out: {reason}" for reason in observation.left_out)])


def _files(path: Path) -> list[Path]:
    return sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]


def _line(name: str, photo: LocalizedPhoto, unit: str) -> str:
    if photo.camera is None:
        return f"{name}: {photo.explanation}"
    seen = ", ".join(obj.name or f"object {obj.object_id}" for obj in photo.objects[:5])
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
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(f"{path} is no JSON: {error}", field="poses") from error
    if not isinstance(rows, list):
        raise InvalidInputError(f"{path} holds no list", field="poses", hint="Write one pose for each photo.")
    return tuple(from_plain(Pose, row, f"poses[{number}]") for number, row in enumerate(rows))
