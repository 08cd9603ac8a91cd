"""`fastsplat serve`: the API and its workers on this machine."""

from __future__ import annotations

import errno
import os
import signal
import socket
import sys
from typing import Annotated

import typer

from fastsplat.cli.lazy_settings import load_settings
from fastsplat.cli.operating.logs import log_to_stderr
from fastsplat_contract.errors import ResourceError

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
    settings = load_settings().model_copy(update={"auth": "off"} if no_auth else {})  # they may be loaded by now
    check_exposure(settings)
    require_free_ports(
        settings.host,
        http_port=settings.http_port,
        grpc_port=settings.grpc_port,
        metrics_port=settings.metrics_port,
    )
    scheme = "http" if settings.tls_cert is None else "https"
    entry = f"with the key in {settings.first_key}" if settings.auth == "on" else "without a key, on this machine alone"
    typer.echo(f"{scheme}://localhost:{settings.http_port}/ opens soon, {entry}; Ctrl-C ends it")
    log_to_stderr("serve")
    roles = {"api": Role([sys.executable, "-m", "fastsplat.cli.main", "api"])}
    raise typer.Exit(run({**roles, **worker_roles(devices, workers, settings.jobs.threads_per_job)}))


def require_free_ports(host: str, **ports: int) -> None:
    """Raises `ResourceError` that names all ports in use; 0 is always free.

    Args:
        host: address to listen on.
        ports: by the setting's name.
    """
    used = {name: port for name, port in ports.items() if _is_in_use(host, port)}
    if used:
        numbers, variables = ", ".join(map(str, used.values())), ", ".join(f"FASTSPLAT_{name.upper()}" for name in used)
        raise ResourceError(
            f"{'ports' if len(used) > 1 else 'port'} {numbers} in use, perhaps by another server of this program",
            field=next(iter(used)),
            hint=f"Stop what uses them, or set {variables} to free ones.",
        )


def _is_in_use(host: str, port: int) -> bool:
    try:
        socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError as error:  # of a host that is none the server says more
        return error.errno == errno.EADDRINUSE
    return False
