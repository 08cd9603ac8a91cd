"""`fastsplat health`: whether the API or a worker of this host is well, for containers and service managers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fastsplat.cli.settings import load_settings
from fastsplat.workers.process_group import machine_id

if TYPE_CHECKING:
    from fastsplat.service.settings import Settings

_TIMEOUT_S = 5.0


def health(role: Annotated[Literal["api", "worker"], typer.Argument(help="What should be running here.")]) -> None:
    """Exit with 0 and without output if the API or a worker of this host is well, else print why and exit with 1."""
    settings = load_settings()
    problem = _api_problem(settings) if role == "api" else _worker_problem(settings)
    if problem:
        typer.echo(problem, err=True)
        raise typer.Exit(1)


def _api_problem(settings: Settings) -> str:
    import ssl
    import urllib.error
    import urllib.request

    encrypted = settings.tls_cert is not None
    url = f"http{'s' if encrypted else ''}://127.0.0.1:{settings.http_port}/readyz"
    # The certificate names the host that clients know, not this loopback address.
    context = ssl._create_unverified_context() if encrypted else None
    try:
        with urllib.request.urlopen(url, timeout=_TIMEOUT_S, context=context):
            return ""
    except (urllib.error.URLError, OSError) as error:
        return f"{url} does not answer: {error}"


def _worker_problem(settings: Settings) -> str:
    from fastsplat.service.store.store import open_store

    store = open_store(settings.data_dir, settings.database_url, settings.artefacts)
    try:
        timeout_s = settings.jobs.stalled_worker_timeout_s
        if store.workers.alive_on(machine_id(), timeout_s):
            return ""
        return f"no worker of this machine had a heartbeat in the last {timeout_s:.0f} s"
    finally:
        store.close()
