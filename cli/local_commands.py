"""`fastsplat train`, `ask` and `view`: a scene in a folder, or the sample scene, without a server."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from fastsplat.cli.serve_command import serve
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.train_more_messages import PresetName

SAMPLE = "sample"
"""What stands for the sample scene in the place of a folder."""

Folder = Annotated[
    Path,
    typer.Argument(
        metavar="DIR",
        help=f"A folder that fastsplat train has made; {SAMPLE}, where there is none of that name: the sample scene.",
    ),
]


def train(
    photos: Annotated[Path, typer.Argument(metavar="PHOTOS", help="A folder of photos, a zip, or a video.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder to train into. Default: the photos' name with -scene.")
    ] = None,
    labels: Annotated[
        str, typer.Option(help="Names to look for, separated by commas; by default detectors decide.")
    ] = "",
    seconds: Annotated[float | None, typer.Option(help="Time for all that comes after structure from motion.")] = None,
    preset: Annotated[PresetName | None, typer.Option(help="draft, balanced or best.")] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Refuse photos of which some cannot be used, instead of leaving these out.")
    ] = False,
) -> None:
    """Train a scene into a folder, without a server."""
    from fastsplat.service.library.training_run import train as train_folder

    names = tuple(part.strip() for part in labels.split(",") if part.strip())
    with train_folder(photos, out, labels=names, seconds=seconds, preset=preset, strict=strict) as scene:
        typer.echo(repr(scene))


def ask(
    folder: Folder,
    texts: Annotated[list[str], typer.Argument(metavar="TEXT...", help="What is looked for, in plain words.")],
    picture: Annotated[Path | None, typer.Option(help="Write a PNG of the answer to one text.")] = None,
) -> None:
    """Ask the scene of a folder, or the sample scene, where things are."""
    from fastsplat.service.library.local_scene import open_scene
    from fastsplat.service.library.sample import open_sample

    if picture is not None and len(texts) != 1:
        raise InvalidInputError(f"one picture of {len(texts)} answers", field="--picture", hint="Ask one text.")
    with open_sample() if _is_sample(folder) else open_scene(folder) as scene:
        for text in texts:
            answer = scene.ask(text)
            typer.echo(answer.sentence)
            for thing in answer.objects or ():
                unit = "m" if thing.meters else "scene units"
                x, y, z = thing.centroid
                typer.echo(f"  thing {thing.thing_id}, {thing.label}, at ({x:.3f}, {y:.3f}, {z:.3f}) {unit}")
        if picture is not None:
            scene.show(texts[0]).save(picture)


def view(folder: Folder) -> None:
    """Show the scene of a folder, or the sample, in the browser, on this machine alone, until SIGTERM or SIGINT."""
    from fastsplat.service.library.local_scene import open_scene
    from fastsplat.service.library.sample import sample_folder

    if _is_sample(folder):
        with sample_folder() as sample:
            _serve(sample)
    open_scene(folder).close()  # says what is wrong before anything starts
    _serve(folder)


def _serve(folder: Path) -> NoReturn:
    os.environ["FASTSPLAT_DATA_DIR"] = str(folder.resolve())
    serve(no_auth=True)
    raise typer.Exit


def _is_sample(folder: Path) -> bool:
    return folder == Path(SAMPLE) and not folder.exists()
