"""What commands share that ask a running server instead of the database on this machine."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.keys import NewKey

if TYPE_CHECKING:
    import httpx

    from fastsplat_client import Client

_KEY_VARIABLE = "FASTSPLAT_KEY"

Server = Annotated[
    str,
    typer.Option(
        help="Ask the server at this URL, e.g. https://robots.example:8000, instead of the database on this machine.",
        envvar="FASTSPLAT_SERVER",
    ),
]
KeyFile = Annotated[
    Path | None,
    typer.Option(help=f"File with your own key for --server. Default: the variable {_KEY_VARIABLE} has the key."),
]
Ca = Annotated[Path | None, typer.Option(help="PEM certificates to trust in place of the system's, for --server.")]


def connect(server: str, key_file: Path | None, ca: Path | None, project: str) -> Client:
    """A client of the server; `project` is for operators, "" is the key's own.

    Raises:
        InvalidInputError: the key's file cannot be read.
    """
    from fastsplat_client import Client  # loads gRPC

    key = os.environ.get(_KEY_VARIABLE, "")
    if key_file is not None:
        try:
            key = key_file.read_text().strip()
        except (OSError, UnicodeDecodeError) as error:
            raise InvalidInputError(f"{key_file} cannot be read: {error}", field="key-file") from error
    return Client(server, key=key, ca=ca, project=project)


def connect_in_process(carrier: httpx.BaseTransport) -> Client:
    """A client of the server in this process to which `carrier` brings its requests."""
    from fastsplat_client import Client, Retry

    return Client("http://localhost", retry=Retry(tries=1), transport=carrier)


def link_to_share(page: str, made: NewKey) -> str:
    """The address of the page that shows the one scene of a key, see `share_link`."""
    from fastsplat_client import share_link

    return share_link(page, made)
