"""`fastsplat tags`: a sheet to print, whose tags give scenes their meters."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.lazy_settings import load_settings
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
