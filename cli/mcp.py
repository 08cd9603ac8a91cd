"""`fastsplat mcp`: an assistant's tools on standard input and output, over a running server."""

from __future__ import annotations

from contextlib import nullcontext
from importlib.metadata import version

import typer

from fastsplat.cli.remote import Ca, KeyFile, Server, connect


def mcp(
    server: Server = "http://127.0.0.1:8000",
    key_file: KeyFile = None,
    ca: Ca = None,
    project: str = typer.Option("", help="For operators: the project to ask about; by default the key's own."),
) -> None:
    """Speak MCP (Model Context Protocol) on standard input and output: for assistants that start their tools.

    A server speaks the same at its address /mcp.
    """
    from fastsplat_client.assistant import assistant_server  # half a second, which no other command is to wait for

    with connect(server, key_file, ca, project) as client:
        assistant_server(lambda request: nullcontext(client), version("fastsplat")).run("stdio")
