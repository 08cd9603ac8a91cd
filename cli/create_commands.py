"""`fastsplat scenes create`, `train-more` and `withdraw-photos`: jobs that a worker does."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, cast

import typer

from fastsplat.cli.options import SceneId, Watch, service_command
from fastsplat.cli.scene_commands import scenes_app
from fastsplat.cli.session import Session
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.operations import Lens, Movers, Operation, PresetName, Privacy, SceneOptions, UpAxis

Labels = Annotated[str, typer.Option(help="Names to look for, separated by commas. Default: the server decides.")]
Preset = Annotated[PresetName | None, typer.Option(help="Default: the server's.")]


@service_command(scenes_app)
def create(
    session: Session,
    capture: Annotated[
        Path,
        typer.Argument(
            metavar="CAPTURE",
            help="A folder of photos, an archive of one, a video, or a splat (PLY or SPZ) of another tool.",
        ),
    ],
    name: Annotated[str, typer.Option(help="The scene's name for people. Default: that of the file or folder.")] = "",
    labels: Labels = "",
    seconds: Annotated[
        float | None, typer.Option(help="Time for all that comes after structure from motion. Default: the preset's.")
    ] = None,
    preset: Preset = None,
    max_gaussians: Annotated[int | None, typer.Option(help="Hard budget.")] = None,
    priority: Annotated[int, typer.Option(help="Higher ones are trained first.")] = 0,
    movers: Annotated[Movers | None, typer.Option(help="ignore: people, cats and dogs are left out.")] = None,
    privacy: Annotated[Privacy | None, typer.Option(help="people: they are in no picture that is kept.")] = None,
    lens: Annotated[Lens | None, typer.Option(help="What the photos were taken with.")] = None,
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
    """Make a scene of photos, a video or a splat: what is sent is checked, and its training is queued.

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
    for file, reason in operation.left_out.items():
        typer.echo(f"{file} is left out: {reason}", err=True)
    session.tell_job(operation, lambda done: f"scene {done.scene_id} is ready", watch=watch)


@service_command(scenes_app, "train-more")
def train_more(
    session: Session,
    scene: SceneId,
    seconds: Annotated[float | None, typer.Option(help="Of optimization.")] = None,
    steps: Annotated[int | None, typer.Option(help="Of optimization, instead of seconds.")] = None,
    preset: Preset = None,
    with_observation: Annotated[
        list[str],
        typer.Option(metavar="ID", help="Photos that join the scene: those of `observe`, by its id. Repeat for more."),
    ] = [],
    watch: Watch = False,
) -> None:
    """Train a scene further, from where it is, with the photos that are kept with it; or let photos join it, and train
    what these show alone."""
    scene_id = session.scene(scene)
    ids = [session.observation(scene_id, each) for each in with_observation]
    operation = session.client.train_more(scene_id, seconds=seconds, steps=steps, preset=preset, observations=ids)
    session.tell_job(operation, _trained, watch=watch)


@service_command(scenes_app, "withdraw-photos")
def withdraw_photos(
    session: Session,
    scene: SceneId,
    photos: Annotated[list[str], typer.Argument(metavar="PHOTO...", help="Names of photos, as `photos` shows them.")],
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask whether you are sure.")] = False,
    watch: Watch = False,
) -> None:
    """Make a scene anew without some of its photos, for ever: all its versions of before are deleted with them."""
    scene_id = session.scene(scene)
    if not yes:
        question = f"Make scene {scene_id} anew without {len(photos)} photos, and delete all its versions for ever?"
        typer.confirm(question, abort=True, err=True)
    operation = session.client.withdraw_photos(scene_id, photos)
    session.tell_job(operation, _withdrawn, watch=watch)


def names_of(labels: str) -> tuple[str, ...]:
    """Names that commas separate."""
    return tuple(part.strip() for part in labels.split(",") if part.strip())


def _withdrawn(operation: Operation) -> str:
    made = operation.withdraw_photos
    assert made is not None
    lost = "".join(f"\nnot made again: {edit}" for edit in made.lost)
    return (
        f"{', '.join(made.photos)} gone, with {len(made.removed)} versions\n"
        f"version {made.version} is trained without; edits of {made.carried} versions are made again{lost}"
    )


def _trained(operation: Operation) -> str:
    made = operation.train_more
    assert made is not None
    psnr = (
        "" if made.psnr is None or made.psnr_before is None else f", PSNR {made.psnr_before:.2f} to {made.psnr:.2f} dB"
    )
    stands = "is current" if made.current else "is there, and another one is current"
    joined = ""
    if made.joined:
        joined = f"{len(made.joined)} photos have joined, {made.unchanged:,} Gaussians are as they were\n"
    joined += "".join(f"left out: {each}\n" for each in made.left_out)
    return (
        f"{joined}{made.steps} steps in {made.seconds:.0f} s, "
        f"{made.gaussians_before:,} to {made.gaussians:,} Gaussians{psnr}\n"
        f"version {made.version} {stands}"
    )
