"""`fastsplat backup` and `fastsplat restore`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.connection import local_store
from fastsplat.cli.lazy_settings import load_settings
from fastsplat.cli.tables import size
from fastsplat_contract.errors import ResourceError


def backup(target: Annotated[Path, typer.Argument(help="A new folder, best on another disk.")]) -> None:
    """Save scenes, jobs, keys and settings to a folder; the service may run meanwhile."""
    from fastsplat.service.store.care.backup import back_up

    settings = load_settings()
    with local_store() as store:
        report = back_up(store, settings.data_dir, settings.database_url, target)
    typer.echo(
        f"{target}: {report.scenes} scenes in {report.versions} versions, {report.uploads} uploads of unfinished jobs, "
        f"{size(report.bytes)}"
    )
    if settings.artefacts.url:
        typer.echo(f"Scenes and uploads are in {settings.artefacts.url}, which is not saved here.", err=True)
    if report.missing:
        raise ResourceError(
            f"{len(report.missing)} folders that the database names are not there, e.g. {report.missing[0]}",
            field="data_dir",
            hint="All else is saved. Run: fastsplat doctor",
        )


def restore(source: Annotated[Path, typer.Argument(help="A folder that `fastsplat backup` made.")]) -> None:
    """Restore a backup into an empty data folder, while no service runs."""
    from fastsplat.service.store.care.backup import restore as restore_backup

    settings = load_settings()
    report = restore_backup(source, settings.data_dir, settings.database_url)
    typer.echo(f"{settings.data_dir}: {report.scenes} scenes in {report.versions} versions; start the service now")
