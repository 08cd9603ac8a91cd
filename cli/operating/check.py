"""`fastsplat check`: what photos promise, before they are posted."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.lazy_settings import load_settings
from fastsplat.cli.tables import duration


def check(photos: Annotated[Path, typer.Argument(help="A folder of photos; it stays as it is.")]) -> None:
    """Check photos before the upload, and predict the training time; status 1 if too few."""
    from fastsplat.service.capture.uploads.photo_check import check_photos  # loads OpenCV
    from fastsplat.service.planning.job_time import PhotoSet, job_seconds
    from fastsplat.service.planning.machine import machine_speed

    settings = load_settings()
    with tempfile.TemporaryDirectory() as scratch:
        checked = check_photos(photos, Path(scratch), settings.capture)
    for photo in checked.photos:
        if photo.advice:
            typer.echo(f"{photo.name}: {photo.advice}")
    for sentence in checked.advice:
        typer.echo(sentence)
    good = sum(not photo.advice for photo in checked.photos)
    typer.echo(f"{good} of {len(checked.photos)} photos are good", err=True)
    set_of_photos = PhotoSet(len(checked.photos), *checked.size)
    seconds = sum(job_seconds(set_of_photos, settings, machine_speed(settings.training.backend)).values())
    typer.echo(f"making a scene of them takes about {duration(seconds)} on this machine", err=True)
    if not checked.is_good:
        raise typer.Exit(1)
