"""`fastsplat mcp`: an assistant's tools on standard input and output, over a running server or the sample scene."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from importlib.metadata import version
from typing import TYPE_CHECKING, Annotated

import typer

from fastsplat.cli.remote import Ca, KeyFile, Server, connect, connect_in_process
from fastsplat_contract.errors import InvalidInputError

if TYPE_CHECKING:
    from fastsplat_client import Client


def mcp(
    server: Server = "http://127.0.0.1:8000",
    key_file: KeyFile = None,
    ca: Ca = None,
    project: str = typer.Option("", help="For operators: the project to ask about; by default the key's own."),
    sample: Annotated[
        bool,
        typer.Option(
            "--sample",
            help="Ask the trained sample scene that comes with the product, in this process: no server, no network. "
            "Names that are given are gone at the end.",
        ),
    ] = False,
) -> None:
    """Speak MCP (Model Context Protocol) on standard input and output: for assistants that start their tools.

    A server speaks the same at its address /mcp.
    """
    if sample and (key_file or ca or project):
        raise InvalidInputError(
            "the sample scene is asked in this process", field="--sample", hint="Leave key file, ca and project out."
        )
    from fastsplat_client.assistant import assistant_server  # half a second, which no other command is to wait for

    with _sample() if sample else connect(server, key_file, ca, project) as client:
        assistant_server(lambda request: nullcontext(client), version("fastsplat")).run("stdio")


@contextmanager
def _sample() -> Iterator[Client]:
    from fastsplat.cli.sample_service import in_process
    from fastsplat.service.library.sample import sample_folder

    with sample_folder() as folder, in_process(folder) as carrier, connect_in_process(carrier) as client:
        yield client
