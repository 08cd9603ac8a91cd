"""Generic REST calls: path, query and body follow from the contract's table of calls."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from types import NoneType
from typing import Any, Protocol, TypeVar, cast
from urllib.parse import quote

from fastsplat_client.errors import read
from fastsplat_client.transport import Transport
from fastsplat_contract.call import Call, RequestT, ResponseT
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.messages.requests import InPages

_PAGE = 500
"""Requested page size; the server may return less."""


class _Page(Protocol):
    @property
    def next_page_token(self) -> str:
        """Empty on the last page."""


Listed = TypeVar("Listed", bound=InPages)
Page = TypeVar("Page", bound=_Page)


class TableCalls:
    """Base class of the parts of `Client`."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def call(self, call: Call[RequestT, ResponseT], request: RequestT, *, timeout_s: float | None = None) -> ResponseT:
        """Makes a call of `fastsplat_contract.calls` whose request is neither a form nor a stream.

        Args:
            call: the call, e.g. `calls.MEASURE_SCENE`.
            asked: its request, e.g. `MeasureRequest`; None if the call has none.
        """
        method, template = call.route.split(" ")
        plain: dict[str, Any] = {} if request is None else to_plain(request)
        path = re.sub(r"{(\w+)}", lambda name: in_path(plain.pop(name[1])), template)
        if method in ("GET", "DELETE"):
            sent: dict[str, Any] = {"params": {name: value for name, value in plain.items() if value is not None}}
        else:
            sent = {"json": plain or None}
        response = self._transport.call(method, path, **sent, repeatable=call.repeatable, timeout_s=timeout_s)
        if call.response is NoneType:
            return cast(ResponseT, None)
        return cast(ResponseT, response.content) if call.response is bytes else read(call.response, response)

    def _pages(self, call: Call[Listed, Page], request: Listed) -> Iterator[Page]:
        token = ""
        while True:
            page = self.call(call, replace(request, page_size=_PAGE, page_token=token))
            yield page
            if not (token := page.next_page_token):
                return


def in_path(name: str) -> str:
    """Escapes a name as one path segment."""
    return quote(name, safe="")


def scene_path(scene_id: str) -> str:
    return f"/v1/scenes/{in_path(scene_id)}"
