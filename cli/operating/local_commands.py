"""`fastsplat train` and `view`: a scene in a folder, or the sample, on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.connection import SAMPLE, is_sample
from fastsplat.cli.operating.browser import serve_in_browser
from fastsplat.cli.scenes.create_commands import Labels, Preset, names_of

Folder = Annotated[
    Path,
    typer.Argument(
        metavar="DIR",
        help=f"A folder that fastsplat train has made; {SAMPLE}, unless there is one so named: the sample scene.",
    ),
]


def train(
    photos: Annotated[Path, typer.Argument(metavar="PHOTOS", help="A folder of photos, a zip, or a video.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder to train into. Default: the photos' name with -scene.")
    ] = None,
    labels: Labels = "",
    seconds: Annotated[float | None, typer.Option(help="Time for all that comes after structure from motion.")] = None,
    preset: Preset = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Refuse photos of which some cannot be used, instead of leaving these out.")
    ] = False,
) -> None:
    """Train a scene into a folder, without a server."""
    from fastsplat.service.library.training_run import train as train_folder

    with train_folder(photos, out, labels=names_of(labels), seconds=seconds, preset=preset, strict=strict) as scene:
        typer.echo(repr(scene))


def view(folder: Folder) -> None:
    """Show the scene of a folder, or the sample, in the browser of this machine."""
    from fastsplat.service.library.local_scene import open_scene
    from fastsplat.service.library.sample import sample_folder

    if is_sample(str(folder)):
        with sample_folder() as sample:
            serve_in_browser(sample)
    open_scene(folder).close()  # says what is wrong before anything starts
    serve_in_browser(folder)
