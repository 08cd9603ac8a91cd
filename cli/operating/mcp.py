"""`fastsplat mcp`: an assistant's tools on standard input and output."""

from __future__ import annotations

from contextlib import nullcontext
from importlib.metadata import version

from fastsplat.cli.session import Session
from fastsplat.service.common.optional_packages import ASSISTANT, needed


def mcp(session: Session) -> None:
    """Serve MCP (Model Context Protocol) on standard input and output, for assistants.

    A server speaks the same at its address /mcp. With --data sample no server and no network are needed, and names
    that are given are gone at the end.
    """
    with needed(ASSISTANT, "an assistant's tools", "", "on this machine"):
        from fastsplat_client.assistant import assistant_server  # half a second, which no other command is to wait for
    client = session.client
    assistant_server(lambda request: nullcontext(client), version("fastsplat")).run("stdio")
