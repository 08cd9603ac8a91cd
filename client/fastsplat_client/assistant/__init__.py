"""Tools of a language model over the service: an MCP server (Model Context Protocol) that asks through `Client`.

Needs the extra `assistant` (the `mcp` package).
"""

from fastsplat_client.assistant.server import assistant_server

__all__ = ["assistant_server"]
