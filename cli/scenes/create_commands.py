"""`fastsplat scenes create`: a job that a worker does."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, cast

import typer

from fastsplat.cli.options import Watch, service_command
from fastsplat.cli.scenes.scene_commands import scenes_app
from fastsplat.cli.session import Session
from fastsplat.service.library.job_lines import left_out
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.jobs.operations import Lens, Movers, PresetName, Privacy, SceneOptions, UpAxis

Labels = Annotated[str, typer.Option(help="Names to look for, separated by commas. Default: the server decides.")]
Preset = Annotated[PresetName | None, typer.Option(help="Default: the server's.")]


@service_command(scenes_app)
def create(
    session: Session,
    capture: Annotated[
        Path,
        typer.Argument(
            metavar="CAPTURE", help="A folder or archive of photos, a video, or another tool's splat (PLY, SPZ, SOG)."
        ),
    ],
    name: Annotated[str, typer.Option(help="The scene's name for people. Default: that of the file or folder.")] = "",
    labels: Labels = "",
    seconds: Annotated[
        float | None, typer.Option(help="Time for all that comes after structure from motion. Default: the preset's.")
    ] = None,
    preset: Preset = None,
    tolerance_db: Annotated[
        float | None, typer.Option(help="In place of a preset: what twice the training may still gain.")
    ] = None,
    max_gaussians: Annotated[int | None, typer.Option(help="Hard budget.")] = None,
    priority: Annotated[int, typer.Option(help="Higher ones are trained first.")] = 0,
    movers: Annotated[Movers | None, typer.Option(help="ignore: people, cats and dogs are left out.")] = None,
    privacy: Annotated[Privacy | None, typer.Option(help="people: they are in no picture that is kept.")] = None,
    lens: Annotated[Lens | None, typer.Option(help="Device that took the photos.")] = None,
    nadir_deg: Annotated[
        float | None, typer.Option(help="Of panoramas: degrees around straight down that are left out.")
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Refuse photos of which some cannot be used, instead of leaving these out.")
    ] = False,
    photos: Annotated[
        Path | None,
        typer.Option(
            help="Of a splat: the folder of its photos with their poses in the splat's world: transforms.json or a "
            "COLMAP model; for a splat of nerfstudio with its dataparser_transforms.json, too. Without, pictures are "
            "rendered around the splat."
        ),
    ] = None,
    up: Annotated[
        str, typer.Option(metavar="AXIS", help="Of a splat: x, -x, y, -y, z or -z is up. Default: estimated.")
    ] = "",
    watch: Watch = False,
) -> None:
    """Check photos, a video or a splat, and queue the training of a scene.

    A splat is not retrained, and its rows keep their order.
    """
    if not capture.exists():
        raise NotFoundError(f"there is no {capture}", field="CAPTURE", hint="Name a folder, an archive or a video.")
    if photos is not None and not (capture.is_file() and photos.is_dir()):
        raise InvalidInputError(
            f"{photos} and {capture} are not a folder of photos and a splat",
            field="--photos",
            hint="Name the splat as CAPTURE, and its photos' folder here.",
        )
    options = SceneOptions(
        labels=names_of(labels),
        time_budget_s=seconds,
        max_gaussians=max_gaussians,
        preset=preset,
        tolerance_db=tolerance_db,
        priority=priority,
        up=cast(UpAxis, up) if up else None,  # the service refuses what is none
        movers=movers,
        privacy=privacy,
        lens=lens,
        nadir_deg=nadir_deg,
        strict=strict,
    )
    operation = session.client.create_scene(
        capture, photos=photos, name=name or capture.resolve().stem, options=options
    )
    for line in () if watch else left_out(operation):
        typer.echo(line, err=True)
    session.tell_job(operation, lambda done: f"scene {done.scene_id} is ready", watch=watch)


def names_of(labels: str) -> tuple[str, ...]:
    """Names that commas separate."""
    return tuple(part.strip() for part in labels.split(",") if part.strip())
