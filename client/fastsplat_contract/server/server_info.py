"""What a client must know of a server before it can talk to all of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from fastsplat_contract.codec.wire import Response


@dataclass(frozen=True)
class ServerInfo(Response):
    """What a server says of itself."""

    version: Annotated[str, Field(description="the release that runs, e.g. 0.1.0")]
    grpc: Annotated[
        str | None,
        Field(
            description='"host:port" of the gRPC interface, or ":port" at the host where this was asked; absent: the '
            "server does not say"
        ),
    ]
