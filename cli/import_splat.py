"""`fastsplat import-splat`: queue a splat of another tool, alone or with its posed photos, as a scene."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, cast

import typer

from fastsplat.cli.local_service import local_store
from fastsplat.service.common.file_names import is_system_file
from fastsplat.service.settings import load_settings
from fastsplat.service.store.records import DEFAULT_PROJECT
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.operations import Operation, SceneOptions, UpAxis

_POLL_S = 0.5

SplatFile = Annotated[
    Path, typer.Argument(metavar="FILE", help="A 3DGS PLY, a compressed PLY of SuperSplat, or an SPZ file.")
]
Photos = Annotated[
    Path | None,
    typer.Option(
        help="Folder of the photos with their poses in the splat's world: transforms.json or a COLMAP model; for a "
        "splat of nerfstudio with its dataparser_transforms.json, too. Without, pictures are rendered around the splat."
    ),
]
Name = Annotated[str, typer.Option(help="The scene's name for people. By default the file's.")]
Up = Annotated[
    str, typer.Option(help="Which axis of the splat's world is up: x, -x, y, -y, z or -z. By default estimated.")
]
Labels = Annotated[str, typer.Option(help="Names to look for, separated by commas; by default the server decides.")]
Project = Annotated[str, typer.Option(help="Whose scene it will be.")]
Wait = Annotated[bool, typer.Option("--wait", help="Follow the job to its end; exit status 1 if it fails.")]


def import_splat(
    file: SplatFile,
    photos: Photos = None,
    name: Name = "",
    up: Up = "",
    labels: Labels = "",
    project: Project = DEFAULT_PROJECT,
    wait: Wait = False,
) -> None:
    """Make a scene of a splat of another tool. It is not retrained, and its rows keep their order.

    The file is checked as any upload is, and queued in the data folder; a worker (`fastsplat serve`) does the rest.
    """
    if not file.is_file():
        raise NotFoundError(f"there is no file {file}", field="FILE", hint="Name a splat: a PLY or an SPZ file.")
    if photos is not None and not photos.is_dir():
        raise NotFoundError(f"there is no folder {photos}", field="--photos", hint="Name the folder of the photos.")
    from fastsplat.service.application.service import open_service  # loads what answers questions

    settings = load_settings()
    _check_project(project)
    options = SceneOptions(
        labels=tuple(part.strip() for part in labels.split(",") if part.strip()),
        up=cast(UpAxis, up) if up else None,  # the service refuses what is none
    )
    with open_service(settings) as shared:
        service = shared.in_project(project)
        with service.new_upload() as upload:
            for path, own in _files(file, photos):
                with path.open("rb") as stream:
                    upload.write(own, stream)
            operation = service.create_scene(upload, name or file.stem, "", options)
        typer.echo(f"scene {operation.scene_id}, job {operation.id}")
        shown = ""
        while wait and not operation.done:
            time.sleep(_POLL_S)
            operation = service.get_operation(operation.id)
            if (line := _progress(operation)) != shown:
                typer.echo(shown := line)
    if operation.error is not None:
        hint = operation.error.details.get("hint", "")
        typer.echo(f"{operation.error.reason}: {operation.error.message}. {hint}", err=True)
        raise typer.Exit(1)


def _check_project(project: str) -> None:
    from fastsplat.service.application.admin.projects import Projects

    with local_store() as store:
        if not Projects(store.projects).exists(project):
            raise NotFoundError(
                f"there is no project {project[:80]!r}", field="--project", hint="See fastsplat projects list."
            )


def _files(file: Path, photos: Path | None) -> list[tuple[Path, str]]:
    """What is sent, and under which names; the splat once, should it lie among the photos."""
    sent = [(file, file.name)]
    for path in sorted(photos.rglob("*")) if photos is not None else ():
        assert photos is not None
        own = path.relative_to(photos)
        if path.is_file() and not is_system_file(own.parts) and not path.samefile(file):
            if own.as_posix() == file.name:
                raise InvalidInputError(
                    f"{photos} has another file called {file.name}", field="--photos", hint="Rename one of them."
                )
            sent.append((path, own.as_posix()))
    return sent


def _progress(operation: Operation) -> str:
    if not operation.stages:
        return str(operation.state)
    last = operation.stages[-1]
    return f"{operation.state} {last.stage} {last.fraction:.0%} {last.message}"
