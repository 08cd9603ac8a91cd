"""`fastsplat localize`: where photos were taken in a finished scene."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.local_service import local_service
from fastsplat.service.store.records import DEFAULT_PROJECT
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.json_codec import from_plain, to_plain
from fastsplat_contract.localize_messages import LocalizeRequest
from fastsplat_contract.poses import Pose


def localize(
    scene: Annotated[str, typer.Argument(help="The scene's id.")],
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
    version: Annotated[str, typer.Option(help="Of the scene. Default: the current one.")] = "",
    project: Annotated[str, typer.Option(help="The project whose scene it is.")] = DEFAULT_PROJECT,
) -> None:
    """Print where photos were taken, what is seen from there and what has changed, as JSON; status 1 if a photo has no
    sure place."""
    request = LocalizeRequest(
        scene_id=scene,
        photos=tuple(_bytes(path) for path in photos),
        focals=tuple(focal),
        poses=() if poses is None else _poses(poses),
        version=version,
    )
    with local_service(project) as service:
        answer = service.localizing.localize(request)
    typer.echo(json.dumps(to_plain(answer), indent=2, ensure_ascii=False))
    if any(photo.refusal is not None for photo in answer.photos):
        raise typer.Exit(1)


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
