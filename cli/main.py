"""The `fastsplat` command: what an operator types."""

from __future__ import annotations

import logging
import os
from importlib.metadata import version
from typing import Annotated

import typer

from fastsplat.cli.demo.command import demo
from fastsplat.cli.lazy_settings import load_settings
from fastsplat.cli.operating.backup_commands import backup, restore
from fastsplat.cli.operating.before_upload import check, tags
from fastsplat.cli.operating.doctor import doctor
from fastsplat.cli.operating.jobs import jobs_app
from fastsplat.cli.operating.keys import keys_app
from fastsplat.cli.operating.local_commands import train, view
from fastsplat.cli.operating.logs import log_to_stderr
from fastsplat.cli.operating.mcp import mcp
from fastsplat.cli.operating.models import models_app
from fastsplat.cli.operating.projects import projects_app
from fastsplat.cli.operating.serve_command import Devices, Workers
from fastsplat.cli.operating.serve_command import serve as serve_command
from fastsplat.cli.operating.status import status
from fastsplat.cli.options import service_command
from fastsplat.cli.scenes import create_commands, edit_commands, export, localize, measure_commands  # noqa: F401  each adds its commands to a group
from fastsplat.cli.scenes.ask_command import ask
from fastsplat.cli.scenes.object_commands import objects_app
from fastsplat.cli.scenes.scene_commands import scenes_app
from fastsplat.service.common.process import die_with_named_parent, loading_modules
from fastsplat_contract.errors import FastSplatError

logger = logging.getLogger(__name__)

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,  # its traceback shows the variables of each frame
    help="Turns photos of a place into a 3D scene that answers questions. Settings: FASTSPLAT_* variables.",
)
for _name, _group in {
    "scenes": scenes_app,
    "objects": objects_app,
    "jobs": jobs_app,
    "keys": keys_app,
    "projects": projects_app,
    "models": models_app,
}.items():
    app.add_typer(_group, name=_name)
service_command(app)(ask)
service_command(app)(status)
service_command(app, json=False)(mcp)
for _command in (demo, train, view, serve_command, check, tags, doctor, backup, restore):
    app.command()(_command)


def _print_version(show: bool) -> None:
    if show:
        typer.echo(f"fastsplat {version('fastsplat')}")
        raise typer.Exit


@app.callback()
def _options(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None: ...


@app.command()
def api() -> None:
    """Run the REST and gRPC APIs alone."""
    with loading_modules():
        from fastsplat.api.server import run

    _start("api")
    run(load_settings())


@app.command()
def worker(devices: Devices = "", workers: Workers = 1) -> None:
    """Run workers alone, one by default; they take their jobs from the database."""
    if devices or workers != 1:
        from fastsplat.cli.operating.serve import serve, worker_roles

        log_to_stderr("serve")
        raise typer.Exit(serve(worker_roles(devices, workers, load_settings().jobs.threads_per_job)))
    with loading_modules():
        from fastsplat.workers.engine.launchers import run

    _start("worker")
    run(load_settings())


def main() -> None:
    """Run the command line; typed errors become one line on stderr and exit status 2."""
    try:
        app()
    except FastSplatError as error:
        hint = f" {error.hint}" if error.hint else ""
        typer.echo(f"{error.reason}: {error.message}.{hint}", err=True)
        raise SystemExit(2) from error


def _start(role: str) -> None:
    from fastsplat.service.capture.untrusted.confinement import missing_protections

    log_to_stderr(role)
    os.umask(0o077)  # photos of homes: what this process and its children write is their owner's alone
    for protection in missing_protections():
        logger.warning("parsers of uploads run without protection: %s", protection)
    die_with_named_parent()  # which is `fastsplat serve`


if __name__ == "__main__":
    main()
