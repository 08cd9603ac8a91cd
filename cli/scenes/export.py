"""`fastsplat scenes export`: a scene, or some of its objects, as a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.options import SceneId, Version, service_command
from fastsplat.cli.scenes.scene_commands import scenes_app
from fastsplat.cli.session import Session
from fastsplat.cli.tables import size
from fastsplat.service.common.files import atomic_file
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.messages.exports import FILE_NAMES, ExportFormat


@service_command(scenes_app)
def export(
    session: Session,
    scene: SceneId,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File to write; its ending says the format.")],
    format: Annotated[ExportFormat | None, typer.Option(help="Default: by FILE's ending.")] = None,
    obj: Annotated[list[int], typer.Option("--object", help="Only this object, by id; several are allowed.")] = [],
    cell: Annotated[float, typer.Option(help="Of points, mesh, cameras, mcap or map: how fine, scene units.")] = 0.0,
    version: Version = "",
) -> None:
    """Write a scene, or some of its objects, as a file for other programs."""
    kind = format or _format_of(file.name.lower())
    scene_id, version = session.at(scene, version)
    write_file(file, session.client.export(scene_id, kind, version=version, objects=obj, cell=cell))


def write_file(file: Path, content: bytes) -> None:
    """Writes a file, whole or not at all; `InvalidInputError` if it cannot be written."""
    try:
        with atomic_file(file) as beside:
            beside.write_bytes(content)
    except OSError as error:
        raise InvalidInputError(f"{file} cannot be written: {error.strerror}", field="FILE") from error
    typer.echo(f"{file}: {size(len(content))}", err=True)


def _format_of(name: str) -> ExportFormat:
    """Finds the format of the longest ending: a.points.ply is of points; `InvalidInputError` for none."""
    endings = {file_name.removeprefix("scene"): kind for kind, file_name in FILE_NAMES.items()}
    fitting = [ending for ending in endings if name.endswith(ending)]
    if not fitting:
        raise InvalidInputError(
            f"{name[-40:]!r} has the ending of no format",
            field="FILE",
            hint=f"There are {', '.join(endings)}; or name one with --format.",
        )
    return endings[max(fitting, key=len)]
