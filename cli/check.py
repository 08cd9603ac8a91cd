"""`fastsplat check`: what photos promise, before they are posted."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from fastsplat.service.settings import load_settings


def check(photos: Annotated[Path, typer.Argument(help="A folder of photos; it stays as it is.")]) -> None:
    """Say which photos are blurred, dark, alike or without overlap, and whether they are too few; status 1 if so."""
    from fastsplat.service.capture.uploads.photo_check import check_photos  # loads OpenCV

    with tempfile.TemporaryDirectory() as scratch:
        checked = check_photos(photos, Path(scratch), load_settings().capture)
    for photo in checked.photos:
        if photo.advice:
            typer.echo(f"{photo.name}: {photo.advice}")
    for sentence in checked.advice:
        typer.echo(sentence)
    good = sum(not photo.advice for photo in checked.photos)
    typer.echo(f"{good} of {len(checked.photos)} photos are good", err=True)
    if not checked.is_good:
        raise typer.Exit(1)
