"""`fastsplat serve`: the API and its workers on this machine."""

from __future__ import annotations

import os
import signal
import sys
from typing import Annotated

import typer

from fastsplat.cli.lazy_settings import load_settings
from fastsplat.cli.operating.logs import log_to_stderr

Devices = Annotated[
    str, typer.Option(help='CUDA devices with workers each, as "0,1"; or "cpu". Default: all that CUDA sees.')
]
Workers = Annotated[int, typer.Option(help="Worker processes a device; without a GPU they share the CPUs evenly.")]


def serve(
    no_auth: Annotated[
        bool, typer.Option("--no-auth", help="Ask for no keys; listens on loopback alone (as FASTSPLAT_AUTH=off).")
    ] = False,
    devices: Devices = "",
    workers: Workers = 1,
) -> None:
    """Run the API and one worker a device on this machine until SIGTERM or SIGINT."""
    from fastsplat.api.access.exposure import check_exposure
    from fastsplat.cli.operating.serve import Role, worker_roles
    from fastsplat.cli.operating.serve import serve as run
    from fastsplat.service.common.process import die_with_named_parent

    die_with_named_parent(signal.SIGTERM)  # which is `fastsplat demo`
    if no_auth:
        os.environ["FASTSPLAT_AUTH"] = "off"  # for the API's own process
    settings = load_settings()
    check_exposure(settings)
    scheme = "http" if settings.tls_cert is None else "https"
    entry = f"with the key in {settings.first_key}" if settings.auth == "on" else "without a key, on this machine alone"
    typer.echo(f"{scheme}://localhost:{settings.http_port}/ opens soon, {entry}")
    log_to_stderr("serve")
    roles = {"api": Role([sys.executable, "-m", "fastsplat.cli.main", "api"])}
    raise typer.Exit(run({**roles, **worker_roles(devices, workers, settings.jobs.threads_per_job)}))
