"""`fastsplat status`: what a server can do, and how much room a project has left."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from fastsplat.cli.local_service import local_service
from fastsplat.cli.remote import Ca, KeyFile, Server, connect
from fastsplat.service.store.records import DEFAULT_PROJECT
from fastsplat_contract.json_codec import to_plain


def status(
    project: Annotated[
        str, typer.Option(help="Whose quotas. Default: by --server your own key's project, else the default one.")
    ] = "",
    server: Server = "",
    key_file: KeyFile = None,
    ca: Ca = None,
) -> None:
    """Print what the server can do: models, workers, limits, and the project's quotas, as JSON."""
    if server:
        with connect(server, key_file, ca, project) as client:
            told = client.server_status()
    else:
        with local_service(project or DEFAULT_PROJECT) as service:
            told = service.status("operator", "")
    typer.echo(json.dumps(to_plain(told), indent=2, ensure_ascii=False))
