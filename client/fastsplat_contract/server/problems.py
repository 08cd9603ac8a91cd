"""An error as it travels over HTTP (RFC 9457), and back into the exception that it was."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from fastsplat_contract.codec.wire import Message


@dataclass(frozen=True)
class Problem(Message):
    """An RFC 9457 problem."""

    type: Annotated[str, Field(description="a URN, one per reason")]
    title: Annotated[str, Field(description="the same for every problem of this status")]
    status: Annotated[int, Field(description="the HTTP status code")]
    detail: Annotated[str, Field(description="what is wrong, in one sentence")]
    reason: Annotated[str, Field(description="UPPER_SNAKE_CASE name, stable across releases and the same over gRPC")]
    request_id: Annotated[
        str, Field(description="that of the X-Request-Id header; finds the request in the server's log")
    ]
    field: Annotated[str | None, Field(description="the input to blame")] = None
    limit: Annotated[str | None, Field(description="the bound that was crossed, with its unit")] = None
    hint: Annotated[str | None, Field(description="what to do about it")] = None
