"""`fastsplat export`: a scene, or some of its things, as a file for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, get_args

import typer

from fastsplat.cli.local_service import local_service
from fastsplat.cli.remote import Ca, KeyFile, Server, connect
from fastsplat.service.common.atomic import atomic_file
from fastsplat.service.store.records import DEFAULT_PROJECT
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.exports import FILE_NAMES, ExportFormat, ExportRequest

_FORMATS: tuple[ExportFormat, ...] = get_args(ExportFormat)


def export(
    scene: Annotated[str, typer.Argument(help="The scene's id.")],
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What to write; its ending says the format.")],
    format: Annotated[str, typer.Option(help=f"{', '.join(_FORMATS)}. Default: by FILE's ending.")] = "",
    thing: Annotated[list[int], typer.Option(help="Only this thing, by id; several are allowed.")] = [],
    cell: Annotated[float, typer.Option(help="Of points, mesh, cameras, mcap or map: how fine, scene units.")] = 0.0,
    version: Annotated[str, typer.Option(help="Of the scene. Default: the current one.")] = "",
    project: Annotated[str, typer.Option(help="The project whose scene it is.")] = "",
    server: Server = "",
    key_file: KeyFile = None,
    ca: Ca = None,
) -> None:
    """Write a scene, or some of its things, as a file for other programs."""
    kind = format or _format_of(file.name.lower())
    if kind not in _FORMATS:
        raise InvalidInputError(
            f"no export format {kind[:40]!r}", field="--format", hint=f"There are {', '.join(_FORMATS)}."
        )
    request = ExportRequest(scene, kind, version, tuple(thing), cell)
    if server:
        with connect(server, key_file, ca, project) as client:
            content = client.export(scene, request.format, version=version, things=thing, cell=cell)
    else:
        with local_service(project or DEFAULT_PROJECT) as service:
            content = service.exports.file(request)
    try:
        with atomic_file(file) as beside:
            beside.write_bytes(content)
    except OSError as error:
        raise InvalidInputError(f"{file} cannot be written: {error.strerror}", field="FILE") from error
    typer.echo(f"{file}: {len(content)} bytes", err=True)


def _format_of(name: str) -> str:
    """The format of the longest ending that the name has, "" without one: a.points.ply is of points, a.ply of ply."""
    endings = {file_name.removeprefix("scene"): kind for kind, file_name in FILE_NAMES.items()}
    fitting = [ending for ending in endings if name.endswith(ending)]
    return endings[max(fitting, key=len)] if fitting else name.rpartition(".")[2]
