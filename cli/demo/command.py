"""`fastsplat demo`: the sample scene in the browser; with `--train` the main job."""

from __future__ import annotations

import os
import shlex
import shutil
import stat
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.lazy_settings import load_settings
from fastsplat.cli.operating.browser import serve_in_browser
from fastsplat.cli.operating.models import pull_with_progress
from fastsplat_contract.errors import ConflictError, FastSplatError, InvalidInputError

FOLDER = Path("demo-output")
OWN_MODELS = Path(".models")
_WRITABLE = stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH
_MARK = ".fastsplat-demo"
"""In a folder that a demonstration has made, and may empty."""


def demo(
    train: Annotated[
        bool, typer.Option("--train", help="Train on the sample's photos, ask, and write what came of it; then end.")
    ] = False,
    photos: Annotated[
        Path | None, typer.Option(help="To train on: a folder, a zip or tar, or a video. Default: the sample's.")
    ] = None,
    ask: Annotated[list[str] | None, typer.Option(help="A question after training; may be repeated.")] = None,
    seconds: Annotated[float | None, typer.Option(help="Time for all that comes after structure from motion.")] = None,
    folder: Annotated[Path, typer.Option(help="Keeps the scene; --train empties it first.")] = FOLDER,
) -> None:
    """Show the scene that --train made, or the sample, in the browser, without keys.

    What is done to it stays in the folder. Models that are missing are fetched.
    """
    if not train and (photos or ask or seconds is not None):
        raise InvalidInputError("--photos, --ask and --seconds are of --train", field="train")
    if photos:
        from fastsplat_client.captures import CaptureFiles

        CaptureFiles(photos)  # raises what it would in a minute, when the models are there and the service runs
    data = folder / "service"
    os.environ["FASTSPLAT_DATA_DIR"] = str(data.resolve())
    if train:
        from fastsplat.cli.demo.main_job import run_main_job

        clear(folder)
        pull_defaults()
        run_main_job(folder, load_settings(), photos=photos, ask=ask or (), seconds=seconds)
        from fastsplat.api.rest.page import BUILT_PAGE

        is_built = (BUILT_PAGE / "index.html").is_file()
        goal = (
            "see the scene" if is_built else "serve the scene to programs alone, as its page is not built (make page)"
        )
        again = shlex.join([sys.argv[0], "demo", *(() if folder == FOLDER else ("--folder", str(folder)))])
        typer.echo(f"To {goal}: {again}")
        return
    prepare(folder)
    try:
        pull_text_encoder()
    except FastSplatError as error:  # without a network all but questions works
        typer.echo(f"{error.message}: questions are not answered, all else works", err=True)
    serve_in_browser(data)


def prepare(folder: Path) -> None:
    """Puts a scene into `folder / "service"` if missing; `ConflictError` if other files are there."""
    from fastsplat.service.store.care.sample_scene import unpack_sample
    from fastsplat.service.store.rows.database import SQLITE_NAME

    if (folder / "service" / SQLITE_NAME).is_file():
        return
    clear(folder)
    unfinished = Path(tempfile.mkdtemp(prefix="unfinished-", dir=folder))
    try:
        unpack_sample(unfinished)
        unfinished.rename(folder / "service")  # whole or not at all
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def clear(folder: Path) -> None:
    """Empties or creates the demonstration's folder; `ConflictError` if other files are in it."""
    if folder.exists() and not (folder.is_dir() and ((folder / _MARK).is_file() or not any(folder.iterdir()))):
        raise ConflictError(
            f"{folder} has files in it that no demonstration made",
            field="folder",
            hint="Name another one by --folder, or remove it.",
        )
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / _MARK).touch()


def pull_defaults() -> None:
    """Fetches missing default models to the settings' folder, or to `OWN_MODELS` if read-only."""
    shared = load_settings().models
    if shared.is_dir() and not shared.stat().st_mode & _WRITABLE:
        typer.echo(f"{shared} is left as it is; its models are copied to {OWN_MODELS}, what is missing comes there")
        for path in shared.rglob("*"):
            copy = OWN_MODELS / path.relative_to(shared)
            if path.is_file() and not copy.is_file():
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, copy)
        os.environ["FASTSPLAT_MODELS"] = str(OWN_MODELS.resolve())
        from fastsplat.service import settings

        settings.load_settings.cache_clear()
    pull_with_progress(load_settings().models)


def pull_text_encoder() -> None:
    """Fetches the settings' text encoder (23 MB by default) if missing; raises as `pull`."""
    settings = load_settings()
    encoder = settings.perception.text_encoder
    if not (settings.models / encoder.rpartition(":")[2]).is_dir():
        pull_with_progress(settings.models, [encoder])
