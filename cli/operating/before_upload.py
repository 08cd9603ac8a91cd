"""`fastsplat tags` and `check`: before photos are taken, and before they are posted."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.lazy_settings import load_settings
from fastsplat.service.library.job_lines import duration
from fastsplat_contract.errors import InvalidInputError


def tags(
    out: Annotated[Path, typer.Argument(help="The PDF to write, A4.")] = Path("tags.pdf"),
    count: Annotated[int, typer.Option(min=1, max=587, help="Number of different tags.")] = 8,
    side_mm: Annotated[
        float | None,
        typer.Option(help="Side of the black square. Default: as the server expects, FASTSPLAT_CAPTURE__TAG_SIDE_M."),
    ] = None,
) -> None:
    """Write AprilTags to print. Photos that show one from several places give meters."""
    from fastsplat.service.capture.world.tag_sheet import tag_pages, write_pdf  # loads OpenCV

    settings = load_settings().capture
    expected = settings.tag_side_m
    side_m = expected if side_mm is None else side_mm / 1e3
    if side_m is None:
        raise InvalidInputError(
            "this server looks for no tags",
            field="side_mm",
            hint="Set FASTSPLAT_CAPTURE__TAG_SIDE_M to the side of the black square in meters.",
        )
    available = settings.last_tag - settings.first_tag + 1
    if count > available:
        raise InvalidInputError(f"{count} tags, and the server counts {available}", field="count", limit=str(available))
    pages = tag_pages(range(settings.first_tag, settings.first_tag + count), side_m)
    write_pdf(pages, side_m, out)
    typer.echo(
        f"{out}: {count} tags of {1e3 * side_m:.4g} mm on {len(pages)} pages. Print at 100 %, lay one or more flat."
    )
    if side_m != expected:
        typer.echo(f"The server must know this side: FASTSPLAT_CAPTURE__TAG_SIDE_M={side_m:.4g}")


def check(photos: Annotated[Path, typer.Argument(help="A folder of photos; it stays as it is.")]) -> None:
    """Check photos before the upload, and predict the training time; status 1 if any can be better."""
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
    if any(photo.not_placed for photo in checked.photos):
        typer.echo("overlap is a rough guess: training may place such photos all the same", err=True)
    good = sum(not photo.advice for photo in checked.photos)
    typer.echo(f"{good} of {len(checked.photos)} photos are good", err=True)
    set_of_photos = PhotoSet(len(checked.photos), *checked.size)
    seconds = sum(job_seconds(set_of_photos, settings, machine_speed(settings.training.backend)).values())
    typer.echo(f"making a scene of them takes about {duration(seconds)} on this machine", err=True)
    if checked.advice or good < len(checked.photos):
        raise typer.Exit(1)
